"""A small scene on disk and a finished run on it; the renderer's error is known, it is put in."""

from __future__ import annotations

import importlib
import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np

import gsut
from gsut.evaluate.evaluation import evaluate, run_metrics
from gsut.evaluate.report import write_report
from gsut.render import write_png
from gsut.run import RunFile, RunFolder, describe_environment

SIZE = 32  # pixels, width and height
HALF_FIELD_DEGREES = 95.0  # at the rim of the fisheye's circle, which touches the image's border
DISTANCE = 4.0  # of everything the renderer shows
_FOCAL = SIZE / 2 / math.radians(HALF_FIELD_DEGREES)
FISHEYE = gsut.Camera(
    "kannala_brandt", [_FOCAL, _FOCAL, SIZE / 2, SIZE / 2, 0, 0, 0, 0], SIZE, SIZE,
    valid_field_angle=math.radians(HALF_FIELD_DEGREES),
)  # fmt: skip
GAUSSIANS = gsut.Gaussians(
    np.zeros((1234, 3)), np.tile([1.0, 0, 0, 0], (1234, 1)), np.zeros((1234, 3)), np.zeros(1234),
    np.zeros((1234, 1, 3)),
)  # fmt: skip


def scene_from_arrays(path: Path, camera: gsut.Camera = FISHEYE, inverted: int | None = None):
    """Six views of random pixels on a circle that looks inward; every third is held out.

    inverted: the photograph that shows the inverse of what the renderer does.
    """
    (path / "images").mkdir(parents=True)
    views = []
    for i, pixels in enumerate(_photographs()):
        file = path / f"images/{i}.png"
        write_png(file, 255 - pixels if i == inverted else pixels)
        views.append(gsut.View(f"images/{i}.png", file, 0, inward_pose(i * math.pi / 3)))
    return gsut.Scene(
        path, (camera,), tuple(views), np.zeros((0, 3)), np.zeros((0, 3)), (1, 2, 4, 5), (0, 3),
        np.array([10.0, 20.0, 30.0]),
        ("1 frame left out because its image is missing: images/9.png",),
    )  # fmt: skip


def _photographs() -> np.ndarray:
    return np.random.default_rng(7).integers(0, 256, (6, SIZE, SIZE, 3), dtype=np.uint8)


def inward_pose(angle: float, radius: float = 3.0, height: float = 1.0) -> np.ndarray:
    """camera_from_world of a camera on a circle about the z axis that looks at the origin."""
    center = np.array([radius * math.cos(angle), radius * math.sin(angle), height])
    z = -center / np.linalg.norm(center)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    pose = np.eye(4)
    pose[:3, :3] = [x, np.cross(z, x), z]
    pose[:3, 3] = -pose[:3, :3] @ center
    return pose


def install(monkeypatch, scene: gsut.Scene, error: float = 0.1) -> None:
    """Makes the renderer show each view's photograph, off by `error` towards mid-grey."""
    photographs = _photographs()

    def render(gaussians, camera, camera_from_world, background=(0.0, 0.0, 0.0),
               order="distance"):  # fmt: skip
        shape = (camera.height, camera.width)
        image = np.full((*shape, 3), 0.5, np.float32)
        for view, photograph in zip(scene.views, photographs, strict=True):
            if np.array_equal(view.camera_from_world, camera_from_world) and shape == (SIZE, SIZE):
                truth = photograph.astype(np.float32) / 255
                image = truth + np.where(truth > 0.5, -error, error).astype(np.float32)
        alpha = np.full(shape, 0.8, np.float32)
        return SimpleNamespace(image=image, alpha=alpha, depth=alpha * DISTANCE)

    for module in (importlib.import_module("gsut.evaluate.evaluation"), gsut):
        monkeypatch.setattr(module, "render", render)
    for module in (gsut, importlib.import_module("gsut.training.record.trained_run")):
        monkeypatch.setattr(module, "load_dataset", lambda path, **_: scene)


def finished_run(path: Path, scene: gsut.Scene, options=None, report: bool = True) -> RunFolder:
    """A run folder as training leaves it behind; the renderer must be installed.

    Without `report` the report is an empty file, which is much faster.
    """
    options = options or gsut.TrainOptions(steps=100)
    run = RunFolder.create(path, options, environment=describe_environment(scene.path))
    for step in range(10, 101, 10):
        row = {"step": step, "seconds": step / 50, "loss": 1 / step, "num_gaussians": 10 * step}
        run.history.append(row | ({"psnr": 20 + step / 50} if step % 50 == 0 else {}))
    evaluation = evaluate(GAUSSIANS, scene, scene.test_indices, render_folder=run.renders)
    metrics = run_metrics(evaluation, GAUSSIANS, scene, options, steps=100, train_seconds=2.0)
    run.write_json(RunFile.METRICS, metrics)
    run.write(RunFile.SCENE, lambda file: gsut.formats.save_ply(file, GAUSSIANS))
    if report:
        write_report(run)
    else:
        run.write_text(RunFile.REPORT, "")
    return run
