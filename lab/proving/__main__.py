"""Proves gsut on made captures: `python -m lab.proving --seeds A:B | night | ...`."""

from __future__ import annotations

import argparse
import collections
import datetime
import json
import math
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from gsut.files import write_file, write_picture
from gsut.page import build_page, build_table
from lab.proving.misfires import BROKEN, find_misfires
from lab.proving.page import count_causes, write_page
from lab.proving.worst import draw_sheet, list_worst

_NIGHT = 300  # captures: no failure among them bounds a rate at 1 %
_FIRST_NIGHT = 1_000_000  # seeds from here on are used once, on their day
_LIMIT = 900.0  # seconds of one capture
_PARTS = ("doctor", "poses", "train")
Row = dict[str, Any]


def build_parser() -> argparse.ArgumentParser:
    """Builds the parser."""
    parser = argparse.ArgumentParser(prog="lab/run prove", description=__doc__)
    parser.add_argument(
        "what",
        nargs="*",
        metavar="night | compare A B | likeness REAL... | worst",
        help="300 captures of today's seeds; two files of rows, paired by seed; statistics "
        "of made captures beside those of real films and folders of photographs; or NAME.jpg of "
        "the ten whose poses are judged worst",
    )
    parser.add_argument(
        "--seeds", metavar="A:B", default="0:24", help="or a list, A,B,C [default: 0:24]"
    )
    parser.add_argument("--jobs", type=int, default=1, help="captures at a time [default: 1]")
    parser.add_argument(
        "--parts",
        default=",".join(_PARTS),
        help="of doctor, poses, scene (a training on these poses, and what it shows between the "
        "pictures), train (on the true ones), bits (two numbers of threads), causes (ten small "
        "trainings, nine with one thing wrong), movers (five of these), "
        "mistakes (the usual ones planted), exact (doctor on right data, whole and thinned) "
        "[default: %(default)s]",
    )
    parser.add_argument(
        "-o",
        "--out",
        type=Path,
        default=Path("runs/prove"),
        metavar="NAME",
        help="NAME.jsonl, which is resumed, and NAME.html [default: runs/prove]",
    )
    parser.add_argument("--one", type=int, help=argparse.SUPPRESS)
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the captures that are missing, and writes the page; 1 if a promise was broken."""
    options = build_parser().parse_args(arguments)
    if options.one is not None:
        from lab.proving.score import score_capture

        print(json.dumps(score_capture(options.one, tuple(options.parts.split(",")))))
        return 0
    what, names = (options.what or [""])[0], [Path(name) for name in options.what[1:]]
    if what == "compare":
        heading = ("misfire", "only before", "only after", "both", "p (sign test)")
        table = compare_rows(*(read_rows(name) for name in names))
        return _show_table(table, heading, options.out, "Before and after")
    if what == "likeness":
        from lab.proving import likeness

        options.parts = "poses"
        real = [likeness.measure_real(name) for name in names]
        made = [likeness.measure_made(row) for row in prove(_list_seeds(options), options)]
        table = likeness.compare_distributions(real, made)
        return _show_table(table, likeness.HEADING, options.out, "Made and real captures")
    options.parts = "poses" if what == "worst" else options.parts
    rows = prove(_list_seeds(options), options)
    if what == "worst":
        sheet = options.out.with_suffix(".jpg")
        write_picture(sheet, draw_sheet(list_worst(rows) or rows)[..., ::-1], 75)
        print(sheet)
        return 0
    write_page(rows, options.out.with_suffix(".html"), "Proving ground")
    counts = collections.Counter(m.kind for row in rows for m in find_misfires(row))
    for kind, count in counts.most_common():
        print(f"{count:4} {kind}")
    for name, said, count, is_right in count_causes(rows):
        print(f"{count:4} {name}: {said}{'' if is_right else ' (wrong)'}")
    print(options.out.with_suffix(".html"))
    return int(any(counts[kind] for kind in BROKEN))


def _show_table(
    table: Sequence[tuple[object, ...]], heading: Sequence[str], out: Path, title: str
) -> int:
    out.parent.mkdir(parents=True, exist_ok=True)
    page = out.with_suffix(".html")
    write_file(page, build_page(title, [], [build_table(table, heading)]))
    for line in (heading, *table):
        print(*line, sep=" | ")
    print(page)
    return 0


def _list_seeds(options: argparse.Namespace) -> Sequence[int]:
    if options.what[:1] == ["night"]:
        day = (datetime.date.today() - datetime.date(2026, 1, 1)).days
        first = _FIRST_NIGHT + _NIGHT * day
        return range(first, first + _NIGHT)
    if ":" not in options.seeds:
        return [int(number) for number in options.seeds.split(",")]
    first, last = (int(number) for number in options.seeds.split(":"))
    return range(first, last)


def prove(seeds: Sequence[int], options: argparse.Namespace) -> list[Row]:
    """Scores the captures whose rows are not in the file yet; returns all rows."""
    file = options.out.with_suffix(".jsonl")
    file.parent.mkdir(parents=True, exist_ok=True)
    done = {row["seed"]: row for row in read_rows(file)} if file.is_file() else {}
    missing = [seed for seed in seeds if seed not in done]
    with ThreadPoolExecutor(options.jobs) as pool, file.open("a", encoding="utf-8") as out:
        for row in pool.map(lambda seed: _score_apart(seed, options.parts), missing):
            out.write(json.dumps(row) + "\n")
            out.flush()
            done[row["seed"]] = row
            kinds = [misfire.kind for misfire in find_misfires(row)]
            print(row["seed"], row.get("family"), *kinds, sep="; ", flush=True)
    return [done[seed] for seed in seeds]


def _score_apart(seed: int, parts: str) -> Row:
    """Scores a capture in a process of its own, so that nothing of it stops the others."""
    command = [sys.executable, "-m", "lab.proving", "--one", str(seed), "--parts", parts]
    try:
        run = subprocess.run(command, capture_output=True, text=True, timeout=_LIMIT, check=False)
    except subprocess.TimeoutExpired:
        return {"seed": seed, "failed": f"not done in {_LIMIT:.0f} s"}
    if run.returncode != 0:
        return {"seed": seed, "failed": run.stderr[-2000:]}
    return json.loads(run.stdout.strip().splitlines()[-1])


def read_rows(file: Path) -> list[Row]:
    """Reads the rows of a run."""
    return [json.loads(line) for line in file.read_text("utf-8").splitlines() if line]


def compare_rows(first: Sequence[Row], second: Sequence[Row]) -> list[tuple[object, ...]]:
    """Compares two runs by the captures that both have: each kind of misfire, paired by seed."""
    before = {row["seed"]: {m.kind for m in find_misfires(row)} for row in first}
    after = {row["seed"]: {m.kind for m in find_misfires(row)} for row in second}
    shared = sorted(before.keys() & after.keys())
    kinds = sorted({kind for seed in shared for kind in before[seed] | after[seed]})
    return [_pair(kind, shared, before, after) for kind in kinds]


def _pair(kind: str, seeds: Sequence[int], before: dict, after: dict) -> tuple[object, ...]:
    """Returns a kind's captures only before, only after and in both, and p of McNemar's test."""
    counts = collections.Counter((kind in before[seed], kind in after[seed]) for seed in seeds)
    gone, new, both = counts[True, False], counts[False, True], counts[True, True]
    tail = sum(math.comb(gone + new, k) for k in range(min(gone, new) + 1)) / 2.0 ** (gone + new)
    return kind, gone, new, both, f"{min(1.0, 2 * tail):.3f}"


if __name__ == "__main__":
    sys.exit(main())
