"""`./run bench photographs`: seconds and peak memory by stage of many large photographs to a scene.

The photographs of the demo's hall are traced small and enlarged: their content is soft, their size
is what memory and decoding depend on. The command runs in a process that is watched.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from gsut._core import InputError
from gsut.sfm.lens.candidates import lens_of_field
from tests.bench.harness import Benchmark, Column, Option, Row, Settings
from tests.bench.walk_film import Film, plan_walk, trace_frames

_TRACED = 400, 300  # pixels
_FIELD_DEGREES = 72.0  # across
_RATE = 3.0  # photographs a second of the walk
_ROUND = 40  # photographs of a round about the table: 23 degrees apart at most
_FULL_FRAME_MM = 43.27  # diagonal for which EXIF's focal length is given
_NOISE = 2.0  # grey levels
_QUALITY = 92  # of the JPEGs
_EXIF_MAKE = 0x010F
_EXIF_MODEL = 0x0110
_EXIF_FOLDER = 0x8769
_EXIF_FOCAL_35MM = 0xA405
# The last file that each stage writes in the run's folder.
_STAGES = {
    "photographs": "poses/capture/capture.json",
    "features and matches": "poses/stages/matches.npz",
    "poses": "poses/report.html",
    "training and report": "scene.html",
}
_LOOK_SECONDS = 0.1  # between two looks at the process


def list_cases(settings: Settings) -> Iterator[Row]:
    """Lists the stages; the first one's measurement runs them all."""
    for stage in (*_STAGES, "all"):
        yield {"stage": stage}


def measure(case: Row, settings: Settings) -> Row:
    """Returns what a stage took; the command runs once."""
    if not hasattr(settings, "rows"):
        count, megapixels = settings.count, settings.megapixels
        pictures = settings.make("photographs", lambda p: write_photographs(p, count, megapixels))
        words = ["scene", str(pictures), "-o", str(settings.folder / "scene"), "--quiet"]
        words += ["--preset", "fast", "--steps", str(settings.steps)]
        settings.rows = watch_stages(words, settings.folder / "scene")
    return settings.rows[case["stage"]]


def write_photographs(folder: Path, count: int, megapixels: float) -> None:
    """Writes JPEGs of a walk through the hall, whose EXIF names a camera and its focal length."""
    import cv2
    from PIL import Image

    camera = lens_of_field(*_TRACED, _FIELD_DEGREES, 1.0)
    seconds = count / _RATE
    path = plan_walk(seconds, around=count / _ROUND, seed=21)
    film = Film(camera, path, seconds, _RATE, 0.0, 0.0, seed=21)
    width = 4 * round((megapixels * 1e6 * _TRACED[0] / _TRACED[1]) ** 0.5 / 4)
    size = width, width * _TRACED[1] // _TRACED[0]
    noise = np.random.default_rng(3).normal(0, _NOISE, (size[1] + 64, size[0] + 64, 1))
    exif = Image.Exif()
    exif[_EXIF_MAKE], exif[_EXIF_MODEL] = "ACME", "One"
    millimetres = camera.params[0] / np.hypot(*_TRACED) * _FULL_FRAME_MM
    exif.get_ifd(_EXIF_FOLDER)[_EXIF_FOCAL_35MM] = round(millimetres)
    folder.mkdir(parents=True)
    for number, picture in enumerate(trace_frames(film)):
        large = cv2.resize(picture, size, interpolation=cv2.INTER_CUBIC).astype(np.float32)
        x, y = number * 7 % 64, number * 13 % 64
        large += noise[y : y + size[1], x : x + size[0]]
        image = Image.fromarray(np.clip(large, 0, 255).astype(np.uint8))
        image.save(folder / f"p{number:04d}.jpg", quality=_QUALITY, exif=exif)


def watch_stages(words: Sequence[str], out: Path) -> dict[str, Row]:
    """Runs `gsut` and returns what each stage, and all together, took.

    Raises:
        InputError: the command fails; names the stage.
    """
    child = subprocess.Popen([sys.executable, "-m", "gsut", *words])
    rows: dict[str, Row] = {}
    begin, cpu_begin = time.perf_counter(), 0.0
    for stage, last in _STAGES.items():
        seen: tuple[float, float] | None = None
        while True:
            seen = read_usage(child.pid) or seen
            if child.poll() is not None or (out / last).is_file():
                break
            time.sleep(_LOOK_SECONDS)
        if seen is None or child.returncode:
            raise InputError(f"gsut {' '.join(words)} ended in {stage} with {child.returncode}")
        rows[stage] = {
            "seconds": time.perf_counter() - begin,
            "cpu_seconds": seen[0] - cpu_begin,
            "peak_mb": seen[1],
        }
        begin, cpu_begin = time.perf_counter(), seen[0]
        if child.poll() is None:
            Path(f"/proc/{child.pid}/clear_refs").write_text("5")  # resets the peak
    if child.wait():
        raise InputError(f"gsut {' '.join(words)} ended with {child.returncode}")
    sums = {key: sum(row[key] for row in rows.values()) for key in ("seconds", "cpu_seconds")}
    return rows | {"all": sums | {"peak_mb": max(row["peak_mb"] for row in rows.values())}}


def read_usage(process: int) -> tuple[float, float] | None:
    """Reads a process's processor seconds and peak memory in MB; None if it has ended."""
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


BENCHMARK = Benchmark(
    help="many photographs of 12 megapixels to a scene: seconds and peak memory by stage",
    columns=(
        Column("stage"),
        Column("seconds", "time", "s", ".1f"),
        Column("cpu_seconds", "time", "CPU-s", ".1f"),
        Column("peak_mb", "peak memory", "MB", ",.0f"),
    ),
    cases=list_cases,
    measure=measure,
    options=(
        Option("count", 200, "photographs"),
        Option("megapixels", 12.0, "of each"),
        Option("steps", 500, "of the training"),
    ),
)
