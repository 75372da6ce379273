"""Finds which way is up in a scene, and its views as they are shown: upright."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gsut.data.scene.scene import Scene
from gsut.orientation import turn_camera

# Length of the cameras' mean up, below which they face in all directions.
_LEAST_UP = 1e-3


def find_upright_poses(scene: Scene, indices: Sequence[int]) -> np.ndarray:
    """Returns camera_from_world (n, 4, 4) of views as their images are shown."""
    views = (scene.views[index] for index in indices)
    poses = [turn_camera(view.camera_from_world, view.turns) for view in views]
    return np.array(poses).reshape(-1, 4, 4)


def find_up(scene: Scene) -> np.ndarray:
    """Finds (3,) up in the world, of length 1: as the dataset states it, or the cameras' mean."""
    ups = -find_upright_poses(scene, scene.train_indices or range(len(scene)))[:, 1, :3]
    up = ups.mean(axis=0) if scene.known_up is None else scene.known_up
    length = np.linalg.norm(up)
    return up / length if length > _LEAST_UP else ups[0]


def count_lens_turns(scene: Scene, camera_index: int) -> int:
    """Counts the quarter turns clockwise that show most of a camera's images upright."""
    turns = [view.turns for view in scene.views if view.camera_index == camera_index]
    return max(sorted(set(turns)), key=turns.count, default=0)
