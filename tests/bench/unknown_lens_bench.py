"""`./run bench unknown_lens`: poses without a lens: what is found, and what that takes more."""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import SolveError
from gsut.data import read_dataset
from gsut.demo import make_demo_scene
from gsut.files import write_file
from gsut.lens import save_camera
from gsut.sfm import PosesOptions, PosesResult, find_poses
from tests.bench.report_rows import table_text

HELP = "poses without a lens: what is found, and the time over that with the lens known"
_HALL_VIEWS, _HALL_SIZE = 30, 320
COLUMNS = (
    ("data", "data", ""),
    ("registered", "registered", "d"),
    ("images", "images", "d"),
    ("lens", "model", ""),
    ("focal [px]", "focal", ".2f"),
    ("known", "known_focal", ".2f"),
    ("error [%]", "focal_error_percent", ".2f"),
    ("sigma [%]", "focal_sigma_percent", ".2f"),
    ("residual [px]", "median", ".3f"),
    ("CPU-s", "cpu_seconds", ".1f"),
    ("lens known", "known_cpu_seconds", ".1f"),
    ("times", "times", ".2f"),
    ("verdict", "verdict", ""),
)


def add_flags(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "data",
        nargs="*",
        metavar="DATA",
        help="datasets, whose lens is the reference, or folders of pictures [default: the demo's "
        "hall]",
    )
    parser.add_argument("--json", metavar="FILE", help="write the rows here")
    parser.add_argument("--threads", type=int, default=0, help="0 = all processors")


def run(arguments: argparse.Namespace) -> int:
    rows = []
    with tempfile.TemporaryDirectory(prefix="gsut-unknown-lens-") as name:
        folder = Path(name)
        data = [Path(path) for path in arguments.data]
        if not data:
            hall = folder / "hall"
            make_demo_scene(hall, _HALL_VIEWS, 0, _HALL_SIZE, seed=1, progress=False)
            data = [hall]
        for number, path in enumerate(data):
            rows.append(measure(path, folder / f"{number}", arguments.threads))
            print(f"{path.name}: {rows[-1].pop('words')}", flush=True)
    print(table_text(rows, COLUMNS))
    if arguments.json:
        write_file(Path(arguments.json), json.dumps(rows, indent=1) + "\n")
    return 0


def measure(data: Path, out: Path, threads: int) -> dict[str, Any]:
    """The row of one capture; `words` is its verdict and its notes."""
    options = PosesOptions(threads=threads)
    row: dict[str, Any] = {"data": data.name, **dict.fromkeys(key for _, key, _ in COLUMNS[1:])}
    try:
        found = find_poses(data, out / "unknown", unknown_lens=True, options=options)
    except SolveError as error:
        return row | {"registered": 0, "verdict": "refused", "words": str(error)}
    lens = found.solution.cameras[0]
    figures = found.figures
    row |= {
        "data": data.name,
        "registered": figures["registered"],
        "images": figures["images"],
        "model": lens.model,
        "focal": float(lens.params[:2].mean()),
        "focal_sigma_percent": figures["focal_sigma_percent"],
        "median": figures["reprojection_error_px"]["median"],
        "cpu_seconds": figures["cpu_seconds"]["total"],
        "verdict": figures["verdict"]["level"],
        "words": "; ".join([figures["verdict"]["what"], *figures["notes"]]),
    }
    if (data / "transforms.json").is_file():
        known = read_dataset(data).frames[0].camera
        focal = float(np.mean(known.params[:2]))
        row |= {"known_focal": focal, "focal_error_percent": 100 * (row["focal"] / focal - 1)}
    seconds = _with_lens(data, found, out, options).figures["cpu_seconds"]["total"]
    return row | {"known_cpu_seconds": seconds, "times": row["cpu_seconds"] / seconds}


def _with_lens(data: Path, found: PosesResult, out: Path, options: PosesOptions) -> PosesResult:
    """Once more, the lens known: the dataset's own, or the one found."""
    if (data / "transforms.json").is_file():
        return find_poses(data, out / "known", options=options)
    file = out / "found.lens.json"
    save_camera(found.solution.cameras[0], file)
    return find_poses(data, out / "known", camera=file, options=options)
