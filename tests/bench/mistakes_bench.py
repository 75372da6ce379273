"""`./run bench mistakes`: which of the usual mistakes the checks before training name."""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gsut
from gsut.check import check_scene, look_closer
from gsut.check.matches import match_neighbours
from gsut.cli._flags import add_json, print_json
from gsut.demo import make_demo_scene
from tests.bench.mistakes import MISTAKES, Mistake, copy_of, write

HELP = "the usual mistakes with poses, lenses and points: named, said to be wrong, or missed"
# Said of good data, too.
_NOT_ABOUT_IT = ("there are no points;", "have no ray", "have the same pose")
NAMED, SAID, MISSED = "named", "said", "missed"


def add_flags(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "data", nargs="*", metavar="DATA", help="nerfstudio datasets [default: the demo's hall]"
    )
    parser.add_argument("--only", metavar="WORDS", default="", help="mistakes with these words")
    parser.add_argument("--verbose", action="store_true", help="print what was said")
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        names = [Path(name) for name in arguments.data]
        for data in names or [make_demo_scene(work / "hall", progress=False)]:
            rows += judge(data, work / "copies" / data.name, arguments.only)
            if not arguments.json:
                _print([row for row in rows if row["data"] == data.name], arguments.verbose)
    if arguments.json:
        print_json(rows)
    return 0


def judge(
    data: Path, work: Path, only: str = "", points: Sequence[bool] = (True, False)
) -> list[dict[str, Any]]:
    """One row a mistake, with and without points; and one of the dataset as it is.

    Args:
        data: a good nerfstudio dataset. work: a folder for copies. only: of the mistakes' names.
        points: whether those that need no points are made with points, or without, or both.
    """
    rows = []
    good = gsut.load_dataset(data)
    started = time.process_time()
    findings = check_scene(good)
    seconds = time.process_time() - started
    bad = [str(finding) for finding in findings if finding.severity != "info"]
    alarms = [text for text in bad if "photographs" in text or text.startswith("error")]
    rows.append({
        "data": data.name, "mistake": "none", "with_points": True, "said": alarms,
        "verdict": "false alarm" if alarms else "good", "cpu_seconds": seconds,
    })  # fmt: skip
    matches, close = match_neighbours(good), None
    for number, mistake in enumerate(MISTAKES):
        if only not in mistake.name:
            continue
        for with_points in (len(good.points) > 0,) if mistake.needs_points else points:
            if mistake.needs_points and not with_points:
                continue
            folder = work / f"{number}{with_points}"
            values = copy_of(data, folder)
            if mistake.make(values, folder) is False:
                continue
            said = _findings(mistake, write(values, folder, with_points), matches)
            doctor = not said and not mistake.images
            if doctor:
                close = match_neighbours(good, closely=True) if close is None else close
                scene = gsut.load_dataset(folder)
                said = [str(finding) for finding in look_closer(scene, close)]
            rows.append({
                "data": data.name, "mistake": mistake.name, "with_points": with_points,
                "said": said, "verdict": _verdict(mistake, said), "by_doctor": doctor,
            })  # fmt: skip
    return rows


def _findings(mistake: Mistake, folder: Path, matches: list) -> list[str]:
    try:
        scene = gsut.load_dataset(folder)
    except gsut.InputError as error:
        return [f"error: {error}"]
    findings = check_scene(scene, None if mistake.images else matches)
    texts = [str(finding) for finding in findings if finding.severity != "info"]
    return [text for text in texts if not any(words in text for words in _NOT_ABOUT_IT)]


def _verdict(mistake: Mistake, said: list[str]) -> str:
    if any(word in text for text in said for word in mistake.says):
        return NAMED
    return SAID if said else MISSED


def _print(rows: list[dict[str, Any]], verbose: bool) -> None:
    print(
        f"\n{rows[0]['data']}: as it is: {rows[0]['verdict']}, {rows[0]['cpu_seconds']:.1f} CPU-s"
    )
    for row in rows[1:]:
        points = "with points" if row["with_points"] else "without"
        doctor = ", by gsut doctor only" if row["by_doctor"] else ""
        print(f"  {row['verdict']:7} {row['mistake']} ({points}{doctor})")
        if verbose:
            for text in row["said"]:
                print(f"            {text}")
    counts = {kind: sum(row["verdict"] == kind for row in rows) for kind in (NAMED, SAID, MISSED)}
    print(", ".join(f"{count} {kind}" for kind, count in counts.items()))
