"""Finds distances that are known before training: depth files, or the points that a view sees.

Points are those of `gsut poses`, of another program or of a LiDAR. Which of them a view sees is
not stored with them: a point well behind another in the same part of the image is left out.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.check import check_depths
from gsut.data import Scene
from gsut.data.scene import find_bad_depths, find_visible_points, has_depths, read_depth

# Share of the weight that is left at the last step (3DGS's depth regularisation).
_LAST = 0.01


def anneal(fraction: float) -> float:
    """Returns the share of the weight at a fraction of the steps, falling from 1 to 1/100."""
    return _LAST**fraction


def check_maps(scene: Scene) -> None:
    """Raises the InputError of the first depth file that the training would stop at.

    Unit and kind of the depths are compared with the points or, if there are few, with matches of
    the photographs.
    """
    if not KnownDepth(scene).by_files:
        return
    for error in find_bad_depths(scene):
        raise error
    for found in check_depths(scene):
        raise InputError(f"{found.where}: {found.what}; {found.advice}")


class KnownDepth:
    """Holds the known distances of each view.

    Args:
        scene: at full resolution.

    Attributes:
        by_files: whether training views have depth files; otherwise points give distances.
    """

    def __init__(self, scene: Scene) -> None:
        self.by_files = has_depths(scene)
        self._seen: dict[int, tuple[np.ndarray, np.ndarray]] = {}

    def map(self, scene: Scene, view: int, camera: Any) -> np.ndarray | None:
        """Returns (H, W) float32 along the rays of `camera`, 0 if unknown; None: nothing is known.

        Args:
            scene: with the view's current pose.
            view: its number.
            camera: the view's lens at any size.

        Raises:
            InputError: a depth file is damaged or of another size than the image.
        """
        if view not in self._seen:
            self._seen[view] = (
                _read_file(scene, view) if self.by_files
                else find_visible_points(scene, view, scene.points)[1:]
            )  # fmt: skip
        places, distances = self._seen[view]
        if not len(distances):
            return None
        known = np.zeros((camera.height, camera.width), np.float32)
        size = np.array([camera.width, camera.height])
        columns, rows = np.minimum((places * size).astype(np.int64), size - 1).T
        known[rows, columns] = distances
        return known

    def forget(self) -> None:
        """Discards what depends on poses and lenses, which have changed."""
        if not self.by_files:
            self._seen.clear()


def _read_file(scene: Scene, view: int) -> tuple[np.ndarray, np.ndarray]:
    depth = read_depth(scene, view)
    if depth is None:
        return np.zeros((0, 2)), np.zeros(0)
    rows, columns = np.nonzero(np.isfinite(depth) & (depth > 0))
    places = (np.stack([columns, rows], axis=1) + 0.5) / depth.shape[::-1]
    return places, depth[rows, columns]
