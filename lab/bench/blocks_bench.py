"""`lab/run bench blocks`: one training against blocks: quality, at seams and elsewhere; cost."""

from __future__ import annotations

import dataclasses
import functools
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

import gsut
from gsut.blocks.layout import Layout
from gsut.gaussians import SH_C0
from lab.demo_tracer import make_demo_scene
from tests.bench.commands import train
from tests.bench.harness import HALL, Benchmark, Column, Option, Row, Settings

_SEAM_SHARE = 0.05  # of a pixel, from which a block counts there
_SEAM_BLOCKS = 2  # from this number on it is a pixel of a seam
ONE, AS_LONG, ROUNDS, WORKERS = "one", "one, as many steps", "blocks", "blocks, two workers"


def list_cases(settings: Settings) -> Iterator[Row]:
    """Lists datasets by kind of training."""
    for data in settings.sets or (HALL, "sponza_fisheye"):
        for training in (ONE, AS_LONG, ROUNDS, WORKERS):
            yield {"data": data, "training": training}


def measure(case: Row, settings: Settings) -> Row:
    """Trains, and compares with one training of as many steps; two workers must have one's bits."""
    runs = {name: _train(case["data"], name, settings) for name in (ROUNDS, AS_LONG)}
    run, metrics = _train(case["data"], case["training"], settings)
    blocks = metrics.get("blocks")
    row = {
        "psnr": metrics["psnr"],
        "num_gaussians": metrics["num_gaussians"],
        "steps": metrics["steps"] + (blocks["coarse"]["steps"] if blocks else 0),
        "cpu_seconds": metrics["cpu_seconds"],
        "seconds": metrics["seconds"],
        "peak_mb": metrics["peak_mb"],
        "below": runs[AS_LONG][1]["psnr"] - metrics["psnr"],
    }
    row |= _measure_seams(run, runs[AS_LONG][0], runs[ROUNDS][0])
    if case["training"] == WORKERS:
        scenes = [(folder / "scene.ply").read_bytes() for folder in (run, runs[ROUNDS][0])]
        row["bits"] = "same" if scenes[0] == scenes[1] else "OTHER"
    return row


def _train(data: str, training: str, settings: Settings) -> tuple[Path, Row]:
    """Trains, unless it has been done: the run's folder and its metrics."""
    path = _find(data, settings)
    out = settings.folder / f"{path.name}-{training.replace(', ', '-').replace(' ', '-')}"
    words = shlex.split(settings.flags)
    if training == AS_LONG:
        metrics = _train(data, ROUNDS, settings)[1]
        words += ["--steps", str(metrics["steps"] + metrics["blocks"]["coarse"]["steps"])]
    else:
        words += ["--steps", str(settings.steps)]
    if "blocks" in training:
        words += ["--blocks", str(settings.blocks)]
    if training == WORKERS:
        words += ["--workers", "2"]
    return out, train(path, out, words)


def _find(data: str, settings: Settings) -> Path:
    if data != HALL:
        return settings.path(data)
    size = settings.size
    return settings.make(f"hall-{size}", lambda p: make_demo_scene(p, size=size, progress=False))


def _measure_seams(run: Path, one: Path, by_blocks: Path) -> Row:
    """Returns how far a run lies below one training at the seams of the blocks and elsewhere."""
    trained, other, seams = _load(run), _load(one), _load(by_blocks)
    layout = Layout.read(str(by_blocks / "blocks/layout.json"))
    scene = other.scene
    errors, pixels = np.zeros((2, 2)), np.zeros(2)
    for index in scene.test_indices:
        mask, seam = scene.mask(index), _find_seam(seams, layout, index)
        truth = scene.image(index).astype(np.float32) / 255
        where = (mask & seam, mask & ~seam)
        pixels += [np.count_nonzero(each) for each in where]
        for row, each in enumerate((trained, other)):
            squared = (_render(each, index) - truth) ** 2
            errors[row] += [squared[part].mean(axis=1).sum() for part in where]
    below = 10 * np.log10(errors[0] / errors[1])
    return {
        "below_seams": float(below[0]),
        "below_rest": float(below[1]),
        "seam_percent": float(100 * pixels[0] / pixels.sum()),
    }


@functools.lru_cache(maxsize=3)
def _load(run: Path) -> Any:
    return gsut.load_run(run)


def _render(run: Any, index: int) -> np.ndarray:
    view, camera = run.scene.views[index], run.scene.camera(index)
    image = gsut.render(run.gaussians, camera, view.motion, background=run.options.background).image
    if run.light is not None:
        image = image * run.light.on(camera, index, view.camera_index)
    return np.clip(image, 0.0, 1.0)


def _find_seam(run: Any, layout: Layout, index: int) -> np.ndarray:
    """Returns (H, W) bool: pixels in which two blocks have more than 5 % each."""
    g = run.gaussians
    owners = layout.find_owners(g.means.astype(np.float64) + g.origin)
    view, camera = run.scene.views[index], run.scene.camera(index)
    count = np.zeros((camera.height, camera.width), int)
    for block in range(len(layout)):
        sh = np.where(owners == block, 0.5 / SH_C0, -0.5 / SH_C0).astype(np.float32)
        shown = dataclasses.replace(g, sh=np.repeat(sh[:, None, None], 3, axis=2))
        count += gsut.render(shown, camera, view.motion).image[..., 0] > _SEAM_SHARE
    return count >= _SEAM_BLOCKS


BENCHMARK = Benchmark(
    help="one training against blocks: held-out PSNR, seams, work, workers",
    columns=(
        Column("data"),
        Column("training"),
        Column("steps", form=",d"),
        Column("psnr", "held-out PSNR", "dB", ".2f"),
        Column("below", "below one", "dB", ".2f"),
        Column("below_seams", "at seams", "dB", ".2f"),
        Column("below_rest", "elsewhere", "dB", ".2f"),
        Column("seam_percent", "seams", "% of pixels", ".1f"),
        Column("num_gaussians", "Gaussians", form=",d"),
        Column("cpu_seconds", "whole command", "CPU-s", ".0f"),
        Column("seconds", "whole command", "s", ".0f"),
        Column("peak_mb", "peak memory", "MB", ",.0f"),
        Column("bits", form="s"),
    ),
    cases=list_cases,
    measure=measure,
    options=(
        Option("blocks", 4, "number of blocks"),
        Option("steps", 500, "of one training"),
        Option("flags", "--max-gaussians 20000 --threads 2", "of all trainings"),
        Option("size", 160, "of the hall's images, pixels"),
    ),
)
