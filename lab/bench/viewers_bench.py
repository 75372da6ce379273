"""`lab/run bench viewers`: pages of a run in the SuperSplat viewer, against gsut's own pictures.

The viewer runs in headless Chromium, with WebGL in software.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

import gsut
from gsut.cli import main
from gsut.gaussians import rotate_upright
from gsut.metrics import psnr
from gsut.render import render
from tests.bench.commands import train
from tests.bench.harness import HALL, Benchmark, Column, Option, Row, Settings

_SIZE = (960, 720)  # of the viewer's window, pixels
_FIELDS_DEGREES = (60.0, 75.0, 90.0)


def list_cases(settings: Settings) -> Iterator[Row]:
    """Lists datasets, as trained and fitted for viewers."""
    for data in settings.sets or (HALL,):
        for page in ("as trained", "--for viewers"):
            yield {"data": data, "page": page}


def measure(case: Row, settings: Settings) -> Row:
    """Converts a trained model to a page and compares the viewer's pictures with exact ones."""
    from real_viewers import level_pose, pinhole, supersplat_pictures, viewer_window

    run = settings.folder / f"{Path(case['data']).name}-viewers"
    train(settings.path(case["data"]), run, ["--preset", "fast", "--steps", str(settings.steps)])
    page = settings.folder / f"{run.name}-{case['page'].strip('-').replace(' ', '-')}.html"
    if not page.exists():
        words = case["page"].split() if case["page"].startswith("--") else []
        main(["convert", str(run), str(page), *words, "--quiet"])
    trained = gsut.load_run(run)
    scene = trained.scene
    indices = np.linspace(0, len(scene.test_indices) - 1, settings.poses).round().astype(int)
    poses = [scene.views[scene.test_indices[k]].camera_from_world for k in indices]
    up = -scene.poses(list(scene.train_indices))[:, 1, :3].mean(axis=0)  # as pages are turned
    cameras = [
        (level_pose(-pose[:3, :3].T @ pose[:3, 3], pose[2, :3], up), field)
        for pose in poses
        for field in _FIELDS_DEGREES
    ]
    background = trained.options.background
    truths = [
        np.clip(
            render(trained.gaussians, pinhole(*_SIZE, field), pose, background=background).image,
            0, 1,
        )
        for pose, field in cameras
    ]  # fmt: skip
    with viewer_window(*_SIZE) as window:
        shown = supersplat_pictures(window, page, cameras, rotate_upright(up))
    each = [psnr(picture, truth) for picture, truth in zip(shown, truths, strict=True)]
    return {"psnr": float(np.mean(each)), "least": min(each)}


BENCHMARK = Benchmark(
    help="pages of a run in the SuperSplat viewer (headless Chromium), against gsut's own pictures",
    columns=(
        Column("data"),
        Column("page"),
        Column("psnr", "PSNR", "dB", ".2f"),
        Column("least", "least", "dB", ".2f"),
    ),
    cases=list_cases,
    measure=measure,
    options=(Option("poses", 3, "held-out views"), Option("steps", 500, "of the training")),
)
