"""`./run bench frames`: poses of ever more frames of one video: seconds, bits, time left."""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from gsut.capture import capture
from gsut.files import write_file
from gsut.sfm import PosesOptions, PosesResult, compare_datasets, find_poses
from tests.bench.poses_bench import PosesBenchOptions, measure_pycolmap
from tests.bench.report_rows import table_text
from tests.bench.walk_bench import FILMS, write_truth

HELP = "poses of ever more frames of one video: seconds by stage, same bits on any threads"
COLUMNS = (
    ("program", "program", ""),
    ("frames", "images", "d"),
    ("registered", "registered", "d"),
    ("threads", "threads", "d"),
    ("features [CPU-s]", "features_cpu_seconds", ".1f"),
    ("matching", "matching_cpu_seconds", ".1f"),
    ("mapping", "mapping_cpu_seconds", ".1f"),
    ("total", "total_cpu_seconds", ".1f"),
    ("a frame", "frame_cpu_seconds", ".2f"),
    ("residual [px]", "median", ".3f"),
    ("ATE [% of extent]", "ate_percent", ".3f"),
    ("rotation median [deg]", "rotation_median_degrees", ".3f"),
    ("bits", "bits", ""),
)
_STAGES = ("features", "matching", "mapping")


def add_flags(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("video", metavar="VIDEO", help="with so many frames to choose")
    parser.add_argument(
        "--counts", default="100,200,300", help="frames to choose [default: %(default)s]"
    )
    parser.add_argument(
        "--threads",
        default="2",
        help="of the first count's runs, each of them once; the others take the first number "
        "[default: %(default)s]",
    )
    parser.add_argument(
        "--film", choices=tuple(FILMS), help="of `./run bench walk`, that the video is: its truth"
    )
    parser.add_argument("--shutter", default="auto", help="see `gsut poses --help`")
    parser.add_argument(
        "--pycolmap", metavar="PYTHON", help="that has pycolmap: the first count beside it"
    )
    parser.add_argument("--json", metavar="FILE", help="write the rows here")


def run(arguments: argparse.Namespace) -> int:
    counts = [int(count) for count in arguments.counts.split(",")]
    threads = [int(number) for number in arguments.threads.split(",")]
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory(prefix="gsut-frames-") as name:
        for place, count in enumerate(counts):
            folder = Path(name) / f"{count}"
            taken = capture([arguments.video], folder / "capture", count=count)
            data = taken.path
            if arguments.film:
                data = write_truth(arguments.film, Path(arguments.video), taken.path, folder)
            first: PosesResult | None = None
            for number in threads if not place else threads[:1]:
                options = PosesOptions(threads=number, shutter=arguments.shutter)
                row, found = measure(taken.path, folder / f"{number}", options)
                if arguments.film:
                    errors = compare_datasets(data, folder / f"{number}")
                    row["ate_percent"] = errors.ate_percent
                    row["rotation_median_degrees"] = float(np.median(errors.rotation_degrees))
                if first is not None:
                    row["bits"] = "same" if _same(first, found) else "OTHER"
                first = first or found
                rows.append(row)
                print(table_text(rows, COLUMNS), flush=True)
            if arguments.pycolmap and not place:
                bench = PosesBenchOptions([str(taken.path)], threads=threads[0])
                theirs = measure_pycolmap(
                    data, "unknown", arguments.pycolmap, bench, sequential=True
                )
                seconds = theirs.get("total_cpu_seconds")
                rows.append(
                    {**dict.fromkeys(key for _, key, _ in COLUMNS), **theirs, "threads": threads[0],
                     "frame_cpu_seconds": seconds / count if seconds else None}
                )  # fmt: skip
    print(table_text(rows, COLUMNS))
    if arguments.json:
        write_file(Path(arguments.json), json.dumps(rows, indent=1) + "\n")
    return 0


def measure(captured: Path, out: Path, options: PosesOptions) -> tuple[dict[str, Any], PosesResult]:
    """The row of one run, and what it found."""
    found = find_poses(captured, out, options=options)
    figures = found.figures
    row = {
        **dict.fromkeys(key for _, key, _ in COLUMNS),
        "program": "gsut",
        "images": figures["images"],
        "registered": figures["registered"],
        "threads": options.threads,
        **{f"{name}_cpu_seconds": figures["cpu_seconds"][name] for name in (*_STAGES, "total")},
        "frame_cpu_seconds": figures["cpu_seconds"]["total"] / figures["images"],
        "median": figures["reprojection_error_px"]["median"],
    }
    return row, found


def _same(one: PosesResult, other: PosesResult) -> bool:
    """Whether poses, points and lens have the same bits."""
    a, b = one.solution, other.solution
    fields = ("camera_from_world", "points", "registered", "observations")
    return a.cameras[0] == b.cameras[0] and all(
        np.array_equal(getattr(a, field), getattr(b, field)) for field in fields
    )
