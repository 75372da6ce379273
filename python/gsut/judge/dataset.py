"""What hypotheses change: the poses and lenses of a dataset."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np

from gsut.judge.hypotheses import Variant
from gsut.lens import Camera

Variants = Iterator[Variant["Dataset"]]


@dataclasses.dataclass(frozen=True, eq=False)
class Dataset:
    """What a hypothesis may change.

    Args:
        poses: (V, B, 4, 4) world_from_camera, one a view or one for each of B moments of a readout.
        cameras: the lenses.
        lens: (V,) index of each view's lens.
        file_axes: (3, 3) camera axes in which the dataset's file names poses.
        paths: views in the order of time, a list for each camera.
    """

    poses: np.ndarray
    cameras: tuple[Camera, ...]
    lens: np.ndarray
    file_axes: np.ndarray
    paths: list[list[int]]

    def move(self, rotation: np.ndarray, center: np.ndarray) -> Dataset:
        """Returns the dataset with other poses, of rotations (V, B, 3, 3) and centres."""
        poses = self.poses.copy()
        poses[..., :3, :3], poses[..., :3, 3] = rotation, center
        return dataclasses.replace(self, poses=poses)

    def place(self, poses: np.ndarray) -> Dataset:
        """Returns the dataset with other poses (V, B, 4, 4)."""
        return dataclasses.replace(self, poses=poses)

    def equip(self, cameras: Sequence[Camera | None]) -> Dataset | None:
        """Returns the dataset with other lenses; None if one is missing, or none differs."""
        known = tuple(camera for camera in cameras if camera is not None)
        if len(known) < len(self.cameras) or known == self.cameras:
            return None
        return dataclasses.replace(self, cameras=known)
