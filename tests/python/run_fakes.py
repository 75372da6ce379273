"""Stand-ins for scene, camera and renderer: tests a run's tooling without training."""

from __future__ import annotations

import dataclasses
import importlib
import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np

import gsut

SIZE = 32  # pixels, width and height
HALF_FIELD_DEGREES = 95.0  # at the rim of the fake fisheye's circle
DISTANCE = 4.0  # of everything the fake renderer shows


@dataclasses.dataclass(frozen=True)
class FakeCamera:
    """An equidistant fisheye whose circle touches the image's border."""

    width: int = SIZE
    height: int = SIZE
    model: str = "fake_fisheye"

    def rays(self):
        y, x = np.mgrid[: self.height, : self.width] + 0.5
        dx, dy = 2 * x / self.width - 1, 2 * y / self.height - 1
        radius = np.hypot(dx, dy)
        theta = radius * math.radians(HALF_FIELD_DEGREES)
        scale = np.sin(theta) / np.maximum(radius, 1e-12)
        rays = np.stack([scale * dx, scale * dy, np.cos(theta)], axis=-1)
        return rays, radius < 1

    def resized(self, width, height):
        return dataclasses.replace(self, width=width, height=height)


class FakeScene:
    """Six views of random pixels on a circle that looks inward; every third is held out."""

    def __init__(self, path: Path = Path("fake_data")):
        rng = np.random.default_rng(7)
        self.path = path
        self.cameras = [FakeCamera()]
        self.notes = ["1 frame left out because its image is missing: images/9.png"]
        self.extent = 2.0
        self.world_offset = np.array([10.0, 20.0, 30.0])
        self.images = rng.integers(0, 256, (6, SIZE, SIZE, 3), dtype=np.uint8)
        self.views = [
            SimpleNamespace(
                name=f"images/{i}.png", camera_from_world=pose, motion=pose, shutter=None
            )
            for i, pose in enumerate(inward_pose(i * math.pi / 3) for i in range(6))
        ]
        self.test_indices = [0, 3]
        self.train_indices = [1, 2, 4, 5]

    def camera(self, index):
        return self.cameras[0]

    def image(self, index):
        return self.images[index]

    def mask(self, index):
        return self.cameras[0].rays()[1]


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


def fake_renderer(scene: FakeScene, error: float = 0.1):
    """A renderer that shows a view's photograph, off by `error` towards mid-grey."""

    def render(gaussians, camera, camera_from_world, background=(0.0, 0.0, 0.0)):
        shape = (camera.height, camera.width)
        image = np.full((*shape, 3), 0.5, np.float32)
        for index, view in enumerate(scene.views):
            if np.array_equal(view.camera_from_world, camera_from_world) and shape == (SIZE, SIZE):
                truth = scene.images[index].astype(np.float32) / 255
                image = truth + np.where(truth > 0.5, -error, error).astype(np.float32)
        alpha = np.full(shape, 0.8, np.float32)
        return SimpleNamespace(image=image, alpha=alpha, depth=alpha * DISTANCE)

    return render


def install(monkeypatch, scene: FakeScene, error: float = 0.1) -> None:
    """Puts the fakes in the place of gsut's renderer and readers."""
    evaluation = importlib.import_module("gsut.evaluate.evaluation")
    trained_run = importlib.import_module("gsut.training.trained_run")
    gaussians, renderer = range(1234), fake_renderer(scene, error)
    monkeypatch.setattr(evaluation, "render", renderer)
    monkeypatch.setattr(gsut, "render", renderer)
    monkeypatch.setattr(trained_run, "load_ply", lambda path: gaussians)
    for reader in (gsut, trained_run):
        monkeypatch.setattr(reader, "load_dataset", lambda path, **_: scene)


def finished_run(path: Path, scene: FakeScene, options=None, report: bool = True):
    """A run folder as training leaves it behind; the fakes must be installed.

    Without `report` the report is an empty file, which is much faster.
    """
    from gsut.evaluate.evaluation import evaluate, run_metrics
    from gsut.evaluate.report import write_report
    from gsut.run.environment import describe_environment
    from gsut.run.folder import METRICS, REPORT, SCENE, RunFolder
    from gsut.run.options import TrainOptions

    options = (options or TrainOptions(steps=100)).resolved()
    run = RunFolder.create(path, options, environment=describe_environment(scene.path))
    gaussians = range(1234)
    for step in range(10, 101, 10):
        row = {"step": step, "seconds": step / 50, "loss": 1 / step, "num_gaussians": 10 * step}
        run.append_history(row | ({"psnr": 20 + step / 50} if step % 50 == 0 else {}))
    evaluation = evaluate(gaussians, scene, scene.test_indices, render_folder=run.renders)
    metrics = run_metrics(evaluation, gaussians, scene, options, steps=100, train_seconds=2.0)
    run.write_json(METRICS, metrics)
    run.write(SCENE, lambda file: file.write_bytes(b"ply"))
    if report:
        write_report(run)
    else:
        run.write_text(REPORT, "")
    return run
