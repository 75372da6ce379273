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
from gsut.data.scene import find_bad_depths, find_visible_points, read_depth
from gsut.run import TrainOptions
from gsut.surface import Cloud, DepthMap

# Share of the weight that is left at the last step (3DGS's depth regularisation).
_LAST = 0.01
# Cosine to the axis above which z and the distance along a ray differ too little to decide.
_NEAR_AXIS = 0.97
# Points that must be seen off the axis before they decide.
_FEWEST_POINTS = 50
# Median relative difference below which files agree with each other.
_AGREES = 0.02
# Times that difference, above which the other reading is wrong.
_WORSE = 2.0


def anneal(fraction: float) -> float:
    """Returns the share of the weight at a fraction of the steps, falling from 1 to 1/100."""
    return _LAST**fraction


def check_maps(scene: Scene, options: TrainOptions) -> None:
    """Raises the InputError of the first depth file that the training would stop at."""
    if not options.surface and len(scene.points):
        return  # it starts from points and does not look at files
    if not KnownDepth(scene).by_files:
        return
    for error in find_bad_depths(scene):
        raise error
    if not len(scene.points) and has_z_depths(scene):
        raise InputError(
            f"{scene.path}: its depth files agree with each other as z along the camera's axis, "
            "and are read as distances along the ray; write "
            '"depth_along": "z" into transforms.json'
        )
    for found in check_depths(scene, None):
        raise InputError(f"{found.where}: {found.what}; {found.advice}")


def has_z_depths(scene: Scene) -> bool:
    """Returns whether depth files hold z instead of distances, judged by each other.

    Each view's depths are compared with those of the view before. They agree as z and not as
    distances, off the axis, where the two differ. Where a scene has points, `check_depths` decides.
    """
    as_distance, as_z = (_measure_disagreement(scene, is_z) for is_z in (False, True))
    return as_z < _AGREES and as_z * _WORSE < as_distance


def _measure_disagreement(scene: Scene, is_z: bool) -> float:
    """Returns the median relative error of depth files, read as distances or z; 0 if unknown."""
    logs, before = [np.zeros(0)], np.zeros((0, 3))
    for view in scene.train_indices:
        depth = read_depth(scene, view)
        if depth is None:
            continue
        camera, motion = scene.camera(view).resize(*depth.shape[::-1]), scene.views[view].motion
        cosine = np.asarray(camera.rays()[0])[..., 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = np.where(cosine > 0, depth / (cosine if is_z else 1.0), np.nan)
            if len(before):
                places, distances = find_visible_points(scene, view, before)
                columns, rows = (places * depth.shape[::-1]).astype(np.int64).T
                log = np.log(depth[rows, columns] / distances)
                logs.append(log[np.isfinite(log) & (cosine[rows, columns] < _NEAR_AXIS)])
        cloud = Cloud()
        cloud.add(DepthMap(camera, motion, np.where(depth > 0, depth, np.nan)))
        before = cloud.to_mesh().vertices if len(cloud) else before
    errors = np.abs(np.concatenate(logs))
    return float(np.median(errors)) if len(errors) >= _FEWEST_POINTS else 0.0


class KnownDepth:
    """Holds the known distances of each view.

    Args:
        scene: at full resolution.

    Attributes:
        by_files: whether training views have depth files; otherwise points give distances.
    """

    def __init__(self, scene: Scene) -> None:
        self.by_files = any(scene.views[i].depth_path is not None for i in scene.train_indices)
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
                else find_visible_points(scene, view, scene.points)
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
