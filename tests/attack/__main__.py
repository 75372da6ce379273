"""`./run attack [--only WORD] [--every N] [--kills N] [--seed N] [--log FILE [--again]]`: the
table, and kills beside."""

from __future__ import annotations

import argparse
import collections
import functools
import importlib.util
import sys
import tempfile
from pathlib import Path

from attack.apart import apart, import_all
from attack.datasets import dataset_cases
from attack.harness import Case, attack, disagreement
from attack.kills import kills
from attack.log import Log
from attack.tables import cases
from attack.world import make_world

MEMORY = 8 << 30  # bytes that no small file may make a command take
SLOW = 5.0  # processor seconds of a row that is worth a look


def main() -> int:
    parser = argparse.ArgumentParser(prog="./run attack", description=__doc__)
    parser.add_argument("--only", default="", metavar="WORD", help="cases whose title has it")
    parser.add_argument("--kills", type=int, default=0, metavar="N", help="of each command")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of their moments")
    parser.add_argument("--every", type=int, default=1, metavar="N", help="each n-th case only")
    parser.add_argument(
        "--log",
        type=Path,
        metavar="FILE",
        help="gets each row that is done; those it has of this state of the tree are left out",
    )
    parser.add_argument("--again", action="store_true", help="only rows with a fault in the log")
    arguments = parser.parse_args()
    if importlib.util.find_spec("resource"):
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    import_all()
    log = Log(arguments.log)
    with tempfile.TemporaryDirectory(prefix="gsut-attack-") as name:
        folder = Path(name)
        (folder / "world").mkdir()
        said, _ = apart(lambda: make_world(folder / "world") and None)
        if said is not None:
            print(said)
            return 1
        attack_rows(arguments, folder, log)
        if arguments.kills:
            n, seed, only = arguments.kills, arguments.seed, arguments.only
            kept = kills(folder / "world", folder, n, seed, only.removeprefix("kill "))
            for number, (name, said) in enumerate(kept):
                log.add(f"kill {name} {seed} {number}", f"kill {name}", said, 0.0)
                if said is not None:
                    print(f"FAULT kill {name}: {said}", flush=True)
    return summary(log)


def attack_rows(arguments: argparse.Namespace, folder: Path, log: Log) -> None:
    """The rows that are asked for and not done yet, each in a process of its own."""
    world = folder / "world"
    rows: list[Case | tuple[Case, Case]] = [
        case for case in cases() if arguments.only in case.title
    ][:: arguments.every]
    rows += [p for p in dataset_cases(world) if arguments.only in p[1].title][:: arguments.every]
    for number, row in enumerate(rows):
        case = row[1] if isinstance(row, tuple) else row
        if case.title in log.done or (arguments.again and log.before.get(case.title) is None):
            continue
        pair = row if isinstance(row, tuple) else (row,)
        carry = disagreement if isinstance(row, tuple) else attack
        said, seconds = apart(functools.partial(carry, *pair, world, folder / f"case-{number}"))
        log.add(case.title, case.kind, said, seconds)
        if said is not None:
            print(f"FAULT {case.title}\n      {said}", flush=True)
        elif seconds > SLOW:
            print(f"slow  {seconds:.1f} s {case.title}", flush=True)


def summary(log: Log) -> int:
    """Prints the counts of what was carried out on this tree; the status to exit with."""
    counts = collections.Counter(kind for kind, _ in log.done.values())
    faults = collections.Counter(kind for kind, said in log.done.values() if said is not None)
    for kind, count in sorted(counts.items()):
        print(f"{kind:22} {count:5} cases, {faults[kind]} faults")
    print(f"{counts.total():28} cases, {faults.total()} faults")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
