"""Opens what is shown: a trained run, a file of Gaussians, or a dataset before training."""

from __future__ import annotations

import dataclasses
import itertools
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import CameraMotion, InputError, exp_pose
from gsut.check import Finding
from gsut.data import Scene, load_dataset
from gsut.data.poses import invert_pose
from gsut.data.scene import find_up, find_upright_poses
from gsut.formats import TABLE, read_scene_file
from gsut.gaussians import seed_from_points
from gsut.lens import Camera
from gsut.render import Light, render
from gsut.run import RunFile, RunFolder
from gsut.training import open_trained, read_light

# Size of the Gaussians that stand for a dataset's points, x the distance to their neighbours.
_POINT_SCALE = 0.25
# Opacity of these Gaussians: nearly opaque.
_POINT_OPACITY = 0.95
# Most points that are shown.
_MOST_POINTS = 300_000
# Percentiles of the centres that bound a scene without cameras.
_MIDDLE_PERCENT = (10.0, 90.0)
# Distances from the middle of such a scene, x its radius, of the poses of which one is the first.
_FIRST_DISTANCES = (2.5, 1.0, 0.5, 0.0)
# Size of the first image of such a scene in pixels.
_FIRST_SIZE = (1280, 960)
# Size of the pictures among which the first pose is chosen.
_TRIAL_SIZE = (160, 120)
# Focal length of the first lens of such a scene, x the image's width.
_FIRST_FOCAL = 0.625


@dataclasses.dataclass
class Stage:
    """What is shown.

    Attributes:
        name: for people.
        kind: "run", "file", "data" or "training".
        gaussians: what is drawn; None before training has started.
        scene: photographs, poses and points; None for a file of Gaussians.
        background: colour behind everything; None: see `render`.
        findings: of the doctor, before training.
        figures: the content of metrics.json, or {}.
        light: of the photographs, if the run has found it.
        antialiased: according to the file, see `SceneFile`.
    """

    name: str
    kind: str
    gaussians: Any = None
    scene: Scene | None = None
    background: tuple[float, float, float] | None = (0.0, 0.0, 0.0)
    findings: Sequence[Finding] = ()
    figures: dict[str, Any] = dataclasses.field(default_factory=dict)
    light: Light | None = None
    antialiased: bool = False
    _first_pose: np.ndarray | None = dataclasses.field(default=None, init=False, repr=False)

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """The dataset's lenses; a pinhole for a file of Gaussians."""
        if self.scene is not None:
            return self.scene.cameras
        return (_make_lens(*_FIRST_SIZE),)

    def place(self) -> dict[str, Any]:
        """Places the scene: up (3,), center (3,), extent, and the first pose (4, 4), upright."""
        if self.scene is not None and len(self.scene):
            return _place_views(self.scene)
        means = np.zeros((1, 3))
        if self.gaussians is not None and len(self.gaussians):
            means = self.gaussians.means + self.gaussians.origin
        low, high = np.percentile(means, _MIDDLE_PERCENT, axis=0)
        center, extent = (low + high) / 2, float(np.linalg.norm(high - low) / 2) or 1.0
        if self._first_pose is None:
            self._first_pose = _find_first_pose(self.gaussians, center, extent)
        up = np.array([0.0, -1.0, 0.0])
        return {"up": up, "center": center, "extent": extent, "pose": self._first_pose}


def _make_lens(width: int, height: int) -> Camera:
    focal = _FIRST_FOCAL * width
    return Camera("pinhole", [focal, focal, width / 2, height / 2], width, height)


def _find_first_pose(gaussians: Any, center: np.ndarray, extent: float) -> np.ndarray:
    """Finds the pose (4, 4), of some around a scene and in it, whose render has most detail.

    From others one looks through a wall, or at one from behind, and sees fog.
    """
    poses, lens = [], _make_lens(*_TRIAL_SIZE)
    for distance, quarter in itertools.product(_FIRST_DISTANCES, range(4)):
        pose = exp_pose([0.0, 0.0, 0.0, 0.0, quarter * np.pi / 2, 0.0])
        pose[:3, 3] = pose[:3, :3] @ -center + [0, 0, distance * extent]
        poses.append(pose)
    if gaussians is None or not len(gaussians):
        return poses[0]

    def measure_detail(pose: np.ndarray) -> float:
        image = render(gaussians, lens, pose).image
        return float(sum(np.abs(np.diff(image, axis=axis)).mean() for axis in (0, 1)))

    return max(poses, key=measure_detail)


def _place_views(scene: Scene) -> dict[str, Any]:
    rows = list(scene.train_indices or range(len(scene)))
    points = scene.points
    if not len(points):
        points = np.array([scene.views[row].camera_center for row in rows])
    center = np.median(points, axis=0)
    first = find_upright_poses(scene, rows[:1])[0]
    return {"up": find_up(scene), "center": center, "extent": scene.extent, "pose": first}


def open_stage(path: str | os.PathLike[str], data: str | None = None) -> Stage:
    """Opens a finished run, a file of Gaussians or a dataset.

    Args:
        path: of one of these, which is recognised by its content.
        data: a run's dataset, if it is not where training read it; photographs beside a file.

    Raises:
        InputError: there is no such file or folder, or it cannot be read.
    """
    place = Path(path)
    if not place.exists():
        raise InputError(
            f"{place}: no such file or folder; give a run, a file of Gaussians or a dataset"
        )
    if (place / RunFile.OPTIONS).is_file():
        run = RunFolder.open(place)
        options, scene, gaussians = open_trained(run, data)
        figures = run.read_json(RunFile.METRICS) or {}
        name = "/".join(place.resolve().parts[-2:])
        return Stage(
            name, "run", gaussians, scene, options.background, figures=figures,
            light=read_light(run, scene),
        )  # fmt: skip
    if place.name == TABLE:
        place = place.resolve().parent
    if (place / TABLE).is_file() or (place.is_file() and place.suffix.lower() != ".json"):
        file = read_scene_file(place)
        photographs = None if data is None else load_dataset(data)
        behind = None if file.no_background else (0.0, 0.0, 0.0)
        return Stage(
            place.resolve().name, "file", file.gaussians, photographs, behind,
            antialiased=file.antialiased,
        )  # fmt: skip
    return make_data_stage(load_dataset(place))


def make_data_stage(scene: Scene) -> Stage:
    """Makes the stage of a dataset, whose points stand for Gaussians."""
    gaussians = None
    if len(scene.points):
        origin = scene.points.mean(axis=0)  # float32 holds them near it
        gaussians = seed_from_points(
            scene.points - origin, scene.point_colors, sh_degree=0, scale_factor=_POINT_SCALE,
            opacity=_POINT_OPACITY, max_gaussians=_MOST_POINTS,
        ).translate(origin)  # fmt: skip
    return Stage(scene.path.resolve().name, "data", gaussians, scene)


def move_motion(scene: Scene, index: int, pose: np.ndarray) -> Any:
    """Moves the rolling shutter's motion of a photograph to another pose.

    Args:
        scene: of the photograph.
        index: of the photograph.
        pose: (4, 4) camera_from_world of the middle of the exposure.

    Returns:
        The motion; `pose` if the photograph has no rolling shutter.
    """
    view = scene.views[index]
    start, end = view.camera_from_world_start, view.camera_from_world_end
    if view.shutter is None or start is None or end is None:
        return pose
    moved = invert_pose(view.camera_from_world) @ pose
    return CameraMotion(start @ moved, end @ moved, view.shutter)
