"""`./run attack [--only WORD] [--every N] [--kills N] [--seed N]`: the table, and kills beside."""

from __future__ import annotations

import argparse
import collections
import importlib.util
import sys
import tempfile
import time
from pathlib import Path

from attack.datasets import dataset_cases
from attack.harness import attack, disagreement
from attack.kills import kills
from attack.tables import cases
from attack.world import make_world

MEMORY = 8 << 30  # bytes that no small file may make a command take


def main() -> int:
    parser = argparse.ArgumentParser(prog="./run attack", description=__doc__)
    parser.add_argument("--only", default="", metavar="WORD", help="cases whose title has it")
    parser.add_argument("--kills", type=int, default=0, metavar="N", help="of each command")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of their moments")
    parser.add_argument("--every", type=int, default=1, metavar="N", help="each n-th case only")
    arguments = parser.parse_args()
    if importlib.util.find_spec("resource"):
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    counts: collections.Counter[str] = collections.Counter()
    faults: collections.Counter[str] = collections.Counter()
    with tempfile.TemporaryDirectory(prefix="gsut-attack-") as name:
        folder = Path(name)
        (folder / "world").mkdir()
        world = make_world(folder / "world")
        wanted = [case for case in cases() if arguments.only in case.title][:: arguments.every]
        pairs = [p for p in dataset_cases(world) if arguments.only in p[1].title]
        for number, case in enumerate([*wanted, *pairs[:: arguments.every]]):
            started = time.process_time()
            if isinstance(case, tuple):
                said, case = disagreement(*case, world, folder / f"case-{number}"), case[1]
            else:
                said = attack(case, world, folder / f"case-{number}")
            seconds = time.process_time() - started
            counts[case.kind] += 1
            if said is not None:
                faults[case.kind] += 1
                print(f"FAULT {case.title}\n      {said}", flush=True)
            elif seconds > 5:
                print(f"slow  {seconds:.1f} s {case.title}", flush=True)
        if arguments.kills:
            n, seed, only = arguments.kills, arguments.seed, arguments.only
            for name, said in kills(world, folder, n, seed, only.removeprefix("kill ")):
                counts[f"kill {name}"] += 1
                if said is not None:
                    faults[f"kill {name}"] += 1
                    print(f"FAULT kill {name}: {said}", flush=True)
    for kind, count in sorted(counts.items()):
        print(f"{kind:22} {count:5} cases, {faults[kind]} faults")
    print(f"{counts.total():28} cases, {faults.total()} faults")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
