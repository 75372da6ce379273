"""Runs the attack: `lab/run attack [--only X] [--every N] [--start N] [--kills N] [--seed N]`."""

from __future__ import annotations

import argparse
import collections
import functools
import importlib.util
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from lab.attack.datasets import list_dataset_cases
from lab.attack.forked import import_everything, run_forked
from lab.attack.harness import attack, find_disagreement
from lab.attack.kills import kill_commands
from lab.attack.numbers import list_numbers, render_numbers
from lab.attack.readers import list_reader_cases, read_wrong_file
from lab.attack.requests import list_requests, send_requests
from lab.attack.tables import list_cases
from lab.attack.world import make_world

MEMORY = 8 << 30  # bytes that no small file may make a command take
SLOW = 5.0  # processor seconds of a case that is worth a look


def main() -> int:
    """Runs the cases and prints the faults and counts; status 1 if there are faults."""
    parser = argparse.ArgumentParser(prog="lab/run attack", description=__doc__)
    parser.add_argument("--only", default="", metavar="WORD", help="cases whose title has it")
    parser.add_argument("--kills", type=int, default=0, metavar="N", help="of each command")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of their moments")
    parser.add_argument("--every", type=int, default=1, metavar="N", help="each n-th case only")
    parser.add_argument(
        "--start", type=int, default=0, metavar="N", help="cases to leave out before"
    )
    arguments = parser.parse_args()
    if importlib.util.find_spec("resource"):
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    import_everything()
    counts: collections.Counter[str] = collections.Counter()
    faults: collections.Counter[str] = collections.Counter()
    with tempfile.TemporaryDirectory(prefix="gsut-attack-") as name:
        folder = Path(name)
        (folder / "world").mkdir()
        said, _ = run_forked(lambda: make_world(folder / "world") and None)
        if said is not None:
            print(said)
            return 1
        for kind, title, said in run_all(arguments, folder):
            counts[kind] += 1
            if said is not None:
                faults[kind] += 1
                print(f"FAULT {title}\n      {said}", flush=True)
    for kind, count in sorted(counts.items()):
        print(f"{kind:22} {count:5} cases, {faults[kind]} faults")
    print(f"{counts.total():28} cases, {faults.total()} faults")
    return 1 if faults else 0


def run_all(arguments: argparse.Namespace, folder: Path) -> Iterator[tuple[str, str, str | None]]:
    """Runs the chosen cases, each in a process of its own, and the kills: kind, title and fault."""
    world, only = folder / "world", arguments.only
    chosen = slice(arguments.start, None, arguments.every)
    rows = [((case,), attack) for case in list_cases() if only in case.title][chosen]
    pairs = [pair for pair in list_dataset_cases(world) if only in pair[1].title]
    rows += [(pair, find_disagreement) for pair in pairs[chosen]]  # type: ignore[misc]
    for number, (given, run) in enumerate(rows):
        scratch = folder / f"case-{number}"
        said, seconds = run_forked(functools.partial(run, *given, world, scratch))
        if said is None and seconds > SLOW:
            print(f"slow  {seconds:.1f} s {given[-1].title}", flush=True)
        yield given[-1].kind, given[-1].title, said
    asked = [row for row in list_requests() if only in row[1]][chosen]
    for kind, title in asked:
        yield kind, title, run_forked(functools.partial(send_requests, title, world))[0]
    for kind, title in [row for row in list_numbers() if only in row[1]][chosen]:
        yield kind, title, run_forked(functools.partial(render_numbers, title))[0]
    listed = list(list_reader_cases())
    for number, (kind, title) in enumerate([row for row in listed if only in row[1]][chosen]):
        scratch = folder / f"reader-{number}"
        yield kind, title, run_forked(functools.partial(read_wrong_file, title, scratch))[0]
        shutil.rmtree(scratch, ignore_errors=True)
    if arguments.kills:
        wanted = only.removeprefix("kill ")
        for name, said in kill_commands(world, folder, arguments.kills, arguments.seed, wanted):
            yield f"kill {name}", f"kill {name}", said


if __name__ == "__main__":
    sys.exit(main())
