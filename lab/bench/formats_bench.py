"""`lab/run bench formats`: bytes of each format of scene files, beside what its pictures lose."""

from __future__ import annotations

import functools
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

import gsut
from gsut import formats
from gsut._core import InputError
from gsut.gaussians import Gaussians, multiply_quaternions, rotations_from_quaternions
from gsut.metrics import psnr
from gsut.render import render
from tests.bench.commands import train
from tests.bench.harness import HALL, Benchmark, Column, Option, Row, Settings

_VIEWS = 4  # held-out ones that are compared
_NO_ERROR_DB = 99.9  # printed where the pictures are equal
_SPZ = "SPZ"
_SPZ_VERSIONS = (3, 4)


def list_cases(settings: Settings) -> Iterator[Row]:
    """Lists the formats, for each number of parts that Gaussians are split into."""
    for data in settings.sets or (HALL,):
        for parts in settings.split:
            for chosen in formats.list_formats():
                for version in _SPZ_VERSIONS if chosen.name == _SPZ else (0,):
                    name = f"{_SPZ} {version}" if version else chosen.name
                    suffix = chosen.suffixes[0]
                    yield {"data": data, "format": name, "_parts": parts, "_suffix": suffix,
                           "_version": version or _SPZ_VERSIONS[0]}  # fmt: skip


def measure(case: Row, settings: Settings) -> Row:
    """Writes and reads a trained model in one format."""
    run, gaussians, truth = _prepare(case["data"], case["_parts"], settings)
    path = settings.folder / f"scene{case['_suffix']}"
    row: Row = {"num_gaussians": len(gaussians)}
    chosen = formats.WriteSettings(spz_version=case["_version"])
    begun = time.process_time()
    try:
        written = formats.save_gaussians(path, gaussians, chosen)
    except InputError as error:  # a library is missing
        return row | {"note": str(error)}
    wrote = time.process_time()
    size = path.stat().st_size
    row |= {
        "megabytes": size / 1e6,
        "bytes_each": size / len(gaussians),
        "clipped": sum(written.clipped.values()),
        "write_cpu_s": wrote - begun,
    }
    if formats.choose_format(path).read is not None:
        found = formats.load_gaussians(path)
        row["read_cpu_s"] = time.process_time() - wrote
        each = [psnr(a, b) for a, b in zip(truth, _render_views(run, found), strict=True)]
        row["psnr"] = min(_NO_ERROR_DB, float(np.mean(each)))
    return row


@functools.lru_cache(maxsize=1)
def _prepare(data: str, parts: int, settings: Settings) -> tuple[Any, Gaussians, list[np.ndarray]]:
    """Returns a run, its Gaussians split, and pictures of held-out views."""
    out = settings.folder / f"{Path(data).name}-formats"
    words = ["--preset", "fast", "--sh-degree", "3", "--steps", str(settings.steps)]
    train(settings.path(data), out, words)
    run = gsut.load_run(out)
    gaussians = split_gaussians(run.gaussians, parts)
    return run, gaussians, _render_views(run, formats.prepare_for_file(gaussians))


def _render_views(run: Any, gaussians: Gaussians) -> list[np.ndarray]:
    scene, background = run.scene, run.options.background
    pictures = []
    for index in list(scene.test_indices or scene.train_indices)[:_VIEWS]:
        camera, pose = scene.camera(index), scene.views[index].motion
        image = render(gaussians, camera, pose, background=background).image
        pictures.append(np.clip(image, 0, 1))
    return pictures


def split_gaussians(gaussians: Gaussians, number: int) -> Gaussians:
    """Splits each Gaussian into smaller ones at random within it, a little unlike each other."""
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


BENCHMARK = Benchmark(
    help="formats of scene files: bytes, seconds, and the PSNR of the pictures",
    columns=(
        Column("data"),
        Column("num_gaussians", "Gaussians", form=",d"),
        Column("format"),
        Column("megabytes", "file", "MB", ",.2f"),
        Column("bytes_each", "a Gaussian", "bytes", ".1f"),
        Column("psnr", "PSNR", "dB", ".1f"),
        Column("write_cpu_s", "write", "CPU-s", ".2f"),
        Column("read_cpu_s", "read", "CPU-s", ".2f"),
        Column("clipped", form=",d"),
        Column("note", form="s"),
    ),
    cases=list_cases,
    measure=measure,
    options=(
        Option("split", (1,), "also with each Gaussian split into this many, for larger scenes"),
        Option("steps", 500, "of the training"),
    ),
)
