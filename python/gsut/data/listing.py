"""What a reader finds in a dataset's files: frames, missing images, points and lists."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gsut._core import Shutter
from gsut.data.colmap import RigPlace
from gsut.data.points import load_points
from gsut.data.scene import DISTANCES, DepthForm
from gsut.lens import Camera


@dataclasses.dataclass
class Frame:
    """One image as a reader found it; poses are world-from-camera, OpenCV axes, dataset's world."""

    name: str
    image_path: Path
    camera: Camera
    world_from_camera: np.ndarray
    world_from_camera_start: np.ndarray | None = None
    world_from_camera_end: np.ndarray | None = None
    mask_path: Path | None = None
    depth_path: Path | None = None
    shutter: Shutter | None = None
    time: float | None = None  # seconds, of a video's frame
    time_ns: int | None = None  # of a recording's: nanoseconds on its own clock
    turns: int = 0  # clockwise, by a quarter each, that show the image upright
    rig: RigPlace | None = None
    depth_form: DepthForm = DISTANCES


@dataclasses.dataclass
class Listing:
    """What a reader found: the frames whose image exists, names of the others, points, lists.

    `missing_depth` names depth and normal files that the dataset lists and that do not exist.
    `source` is the file that lists the images, `points_source` that of the points where it is
    another; `path` the dataset's folder; `up` (3,) the direction that it states, or None.
    """

    path: Path
    source: Path
    frames: list[Frame] = dataclasses.field(default_factory=list)
    missing: list[str] = dataclasses.field(default_factory=list)
    missing_depth: list[str] = dataclasses.field(default_factory=list)
    points: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros((0, 3)))
    point_colors: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros((0, 3), np.uint8))
    listed_train: Sequence[str] | None = None
    listed_test: Sequence[str] | None = None
    notes: list[str] = dataclasses.field(default_factory=list)
    points_source: Path | None = None
    up: np.ndarray | None = None

    def take_points(self, path: Path) -> None:
        """Takes the points of a PLY, LAS or LAZ file; errors: see `load_points`."""
        self.points, self.point_colors = load_points(path, self.notes)
        self.points_source = path
