"""`./run bench photographs`: many large photographs to a scene: seconds and peak memory by stage.

Photographs of the demo's hall, traced small and enlarged: their contents are soft, their size is
what memory and decoding depend on. The command runs in a process of its own, which is watched.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.files import write_file
from gsut.sfm.lens.candidates import make_lens
from tests.bench.report_rows import table_text
from tests.bench.walk_film import Film, film_pictures, walk

HELP = "many photographs of 12 megapixels to a scene: seconds and peak memory by stage"
COLUMNS = (
    ("stage", "stage", ""),
    ("seconds", "seconds", ".1f"),
    ("CPU-s", "cpu_seconds", ".1f"),
    ("peak memory [MB]", "peak_mb", ".0f"),
)
_TRACED = 400, 300
_FIELD = 72.0  # degrees across
# Photographs a second of the walk, and of a round about the table: 23 degrees apart at most.
_RATE, _ROUND = 3.0, 40
_FULL_FRAME = 43.27  # mm, diagonal, which EXIF's focal length is given for
_NOISE = 2.0  # grey levels
_QUALITY = 92
# The last file that each stage writes in the run's folder.
_STAGES = {
    "photographs": "poses/capture/capture.json",
    "features and matches": "poses/stages/matches.npz",
    "poses": "poses/report.html",
    "training and report": "scene.html",
}
_INTERVAL = 0.1  # seconds between two looks


def add_flags(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--count", type=int, default=200, help="photographs [default: %(default)d]")
    parser.add_argument(
        "--megapixels", type=float, default=12.0, help="of each [default: %(default)g]"
    )
    parser.add_argument(
        "--steps", type=int, default=500, help="of the training [default: %(default)d]"
    )
    parser.add_argument("--keep", metavar="FOLDER", help="photographs and scene stay here")
    parser.add_argument("--json", metavar="FILE", help="write the rows here")


def run(arguments: argparse.Namespace) -> int:
    with tempfile.TemporaryDirectory(prefix="gsut-photographs-") as temporary:
        folder = Path(arguments.keep or temporary)
        photographs = folder / "photographs"
        if not photographs.is_dir():
            write_photographs(photographs, arguments.count, arguments.megapixels)
        words = [
            "scene", str(photographs), "-o", str(folder / "scene"), "--quiet", "--preset", "fast",
            "--steps", str(arguments.steps),
        ]  # fmt: skip
        rows = watched(words, folder / "scene")
        state = json.loads((folder / "scene/scene.json").read_text())
    print(table_text(rows, COLUMNS))
    print(
        f"{state['registered']} of {state['pictures']} photographs, {state['psnr']:.2f} dB; "
        f"{state['verdict']['level']}: {state['verdict']['what']}"
    )
    if arguments.json:
        write_file(Path(arguments.json), json.dumps(rows, indent=1) + "\n")
    return 0


def write_photographs(folder: Path, count: int, megapixels: float) -> None:
    """JPEGs of a walk through the hall, whose EXIF names a camera and its focal length."""
    import cv2
    from PIL import Image

    camera = make_lens(*_TRACED, _FIELD, 1.0)
    seconds = count / _RATE
    path = walk(seconds, around=count / _ROUND, seed=21)
    film = Film(camera, path, seconds, _RATE, 0.0, 0.0, seed=21)
    width = 4 * round((megapixels * 1e6 * _TRACED[0] / _TRACED[1]) ** 0.5 / 4)
    size = width, width * _TRACED[1] // _TRACED[0]
    noise = np.random.default_rng(3).normal(0, _NOISE, (size[1] + 64, size[0] + 64, 1))
    exif = Image.Exif()
    exif[0x010F], exif[0x0110] = "ACME", "One"
    exif.get_ifd(0x8769)[0xA405] = round(camera.params[0] / np.hypot(*_TRACED) * _FULL_FRAME)
    partial = folder.with_name("partial")
    partial.mkdir(parents=True)
    for number, picture in enumerate(film_pictures(dataclasses.replace(film, samples=3))):
        large = cv2.resize(picture, size, interpolation=cv2.INTER_CUBIC).astype(np.float32)
        x, y = number * 7 % 64, number * 13 % 64
        large += noise[y : y + size[1], x : x + size[0]]
        image = Image.fromarray(np.clip(large, 0, 255).astype(np.uint8))
        image.save(partial / f"p{number:04d}.jpg", quality=_QUALITY, exif=exif)
    partial.rename(folder)


def watched(words: list[str], out: Path) -> list[dict[str, Any]]:
    """Runs `gsut`; a row a stage, and one of all.

    Raises:
        InputError: it fails.
    """
    child = subprocess.Popen([sys.executable, "-m", "gsut", *words])
    rows: list[dict[str, Any]] = []
    begin, cpu_begin = time.perf_counter(), 0.0
    for stage, last in _STAGES.items():
        seen: tuple[float, float] | None = None
        while True:
            now = _usage(child.pid)
            seen = now or seen
            if child.poll() is not None or (out / last).is_file():
                break
            time.sleep(_INTERVAL)
        if seen is None or child.returncode:
            raise InputError(f"gsut {' '.join(words)} ended in {stage} with {child.returncode}")
        rows.append({
            "stage": stage, "seconds": time.perf_counter() - begin,
            "cpu_seconds": seen[0] - cpu_begin, "peak_mb": seen[1],
        })  # fmt: skip
        begin, cpu_begin = time.perf_counter(), seen[0]
        if child.poll() is None:
            Path(f"/proc/{child.pid}/clear_refs").write_text("5")  # the peak begins anew
    if child.wait():
        raise InputError(f"gsut {' '.join(words)} ended with {child.returncode}")
    sums = {key: sum(row[key] for row in rows) for key in ("seconds", "cpu_seconds")}
    return [*rows, {"stage": "all", **sums, "peak_mb": max(row["peak_mb"] for row in rows)}]


def _usage(process: int) -> tuple[float, float] | None:
    """Processor seconds of a process so far, and its peak of memory in MB; None: it has ended."""
    try:
        status = Path(f"/proc/{process}/status").read_text()
        fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return None
    peak = next((line for line in status.splitlines() if line.startswith("VmHWM")), None)
    if peak is None:
        return None
    ticks = int(fields[11]) + int(fields[12])
    return ticks / os.sysconf("SC_CLK_TCK"), int(peak.split()[1]) / 1024
