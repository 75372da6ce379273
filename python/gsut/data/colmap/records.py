"""What a COLMAP model's files hold, whether read or to be written."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from gsut.lens import Camera


class ImageRow(NamedTuple):
    """One image: its camera-from-world rotation and translation."""

    image_id: int
    quat_wxyz: list[float]
    translation: list[float]
    camera_id: int
    name: str
    where: str


class RigPlace(NamedTuple):
    """Where a picture was taken on a rig: the rig, its camera, and the instant, by numbers."""

    rig: int
    camera: int
    instant: int


@dataclasses.dataclass
class ColmapImage:
    """One image: `pixels` (M, 2) and `points` (M,), the place in the model's points of each.

    `rig` is its place on a rig that COLMAP can hold, see `hold_rigs`.
    """

    number: int
    name: str
    camera: Camera
    camera_from_world: np.ndarray
    pixels: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros((0, 2)))
    points: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(0, np.int64))
    rig: RigPlace | None = None
