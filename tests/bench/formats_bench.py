"""`./run bench formats`: bytes of each format of scene files, beside what its pictures lose."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from gsut import formats
from gsut._core import InputError
from gsut.gaussians import Gaussians, multiply_quaternions, rotations_from_quaternions
from gsut.render import psnr, render
from gsut.run import RunFolder
from gsut.training import read_trained
from tests.bench.report_rows import add_files, bar, check_files, numbers, print_and_write

HELP = "formats of scene files: bytes, seconds, and the PSNR of the pictures"
_COLUMNS = (
    ("Gaussians", "num_gaussians", ",d"),
    ("format", "format", ""),
    ("MB", "megabytes", ",.2f"),
    ("bytes each", "bytes_each", ".1f"),
    ("PSNR dB", "psnr", ".1f"),
    ("write cpu s", "write_cpu_s", ".2f"),
    ("read cpu s", "read_cpu_s", ".2f"),
    ("clipped", "clipped", ",d"),
    ("", "note", ""),
)
_VIEWS = 4  # held-out ones that are compared
_NO_ERROR_DB = 99.9  # what is printed where the pictures are equal


def add_flags(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", metavar="RUN", help="a finished run with harmonics")
    parser.add_argument("--data", metavar="DATA", help="its dataset, if that has moved")
    parser.add_argument(
        "--split", default="1", metavar="N,...",
        help="also with each Gaussian split into N thin ones, for larger scenes [default 1]",
    )  # fmt: skip
    add_files(parser)


def run(arguments: argparse.Namespace) -> int:
    check_files(arguments)
    parts = numbers(arguments.split, int, "--split")
    if not parts or min(parts) < 1:
        raise InputError(f"--split takes numbers from 1, found {arguments.split!r}")
    options, scene, gaussians = read_trained(RunFolder.open(arguments.folder), arguments.data)
    rows = []
    with bar(len(parts) * (len(formats.formats()) + 1)) as begin:
        for number in parts:
            rows += measure(scene, split(gaussians, number), options.background, begin)
    print_and_write(rows, _COLUMNS, arguments)
    return 0


def split(gaussians: Gaussians, number: int) -> Gaussians:
    """Each Gaussian as `number` smaller ones at random within it, a little unlike each other."""
    if number == 1:
        return gaussians
    g, rng = gaussians, np.random.default_rng(0)
    rows = np.repeat(np.arange(len(g)), number)
    unit = g.quats / np.linalg.norm(g.quats, axis=1, keepdims=True)
    axes = rotations_from_quaternions(unit)[rows] * np.exp(g.log_scales)[rows, None]
    means = g.means[rows] + 0.7 * np.einsum("nij,nj->ni", axes, rng.normal(size=(len(rows), 3)))
    turned = unit[rows] + 0.02 * rng.normal(size=(len(rows), 4))
    return Gaussians(
        means.astype(np.float32),
        multiply_quaternions(np.array([1.0, 0, 0, 0]), turned),
        g.log_scales[rows] - np.log(number) / 3 + 0.1 * rng.normal(size=(len(rows), 3)),
        g.opacity_logits[rows] + 0.1 * rng.normal(size=len(rows)),
        g.sh[rows] + 0.01 * rng.normal(size=(len(rows), *g.sh.shape[1:])),
        g.origin,
    )


def measure(
    scene: Any, gaussians: Gaussians, background: Sequence[float], begin: Callable[[str], None]
) -> list[dict[str, Any]]:
    """One row a format; of SPZ two."""
    views = list(scene.test_indices or scene.train_indices)[:_VIEWS]

    def pictures(shown: Gaussians) -> list[np.ndarray]:
        return [
            np.clip(
                render(shown, scene.camera(i), scene.views[i].motion, background=background).image,
                0, 1,
            )
            for i in views
        ]  # fmt: skip

    truth, rows = pictures(formats.for_file(gaussians)), []
    with TemporaryDirectory(prefix="gsut-bench-") as folder:
        for chosen in formats.formats():
            for version in (3, 4) if chosen.name == "SPZ" else (3,):
                name = f"{chosen.name} {version}" if chosen.name == "SPZ" else chosen.name
                begin(name)
                path = Path(folder) / f"scene{chosen.suffixes[0]}"
                settings = formats.WriteSettings(spz_version=version)
                try:
                    row = _row(path, gaussians, settings, truth, pictures)
                except InputError as error:  # a library is missing
                    row = {"note": str(error)}
                rows.append({"num_gaussians": len(gaussians), "format": name} | row)
    return rows


def _row(
    path: Path,
    gaussians: Gaussians,
    settings: formats.WriteSettings,
    truth: list[np.ndarray],
    pictures: Callable[[Gaussians], list[np.ndarray]],
) -> dict[str, Any]:
    begun = time.process_time()
    written = formats.save_gaussians(path, gaussians, settings)
    wrote = time.process_time()
    row: dict[str, Any] = {
        "megabytes": path.stat().st_size / 1e6,
        "bytes_each": path.stat().st_size / len(gaussians),
        "clipped": sum(written.clipped.values()),
        "write_cpu_s": wrote - begun,
    }
    if formats.format_of(path).read is not None:
        found = formats.load_gaussians(path)
        row["read_cpu_s"] = time.process_time() - wrote
        each = [psnr(a, b) for a, b in zip(truth, pictures(found), strict=True)]
        row["psnr"] = min(_NO_ERROR_DB, float(np.mean(each)))
    return row
