"""Finds the pixels of a held-out view that show what no training view could see."""

from __future__ import annotations

from typing import Any

import numpy as np

from gsut.gaussians import OPAQUE

# Pixels between the rays that are followed, each way; what is unseen is larger.
_EVERY = 4


def find_unseen(scene: Any, index: int, rendered: Any) -> np.ndarray:
    """Finds the pixels whose surface lies in the field of view of no training view.

    Surfaces are those of the render; what other surfaces hide from the training views counts as
    seen.

    Args:
        scene: with training views.
        index: of the view.
        rendered: the view's render, with alpha and depth.

    Returns:
        (H, W) bool; all False for a training view.
    """
    alpha = np.asarray(rendered.alpha, np.float64)
    unseen = np.zeros(alpha.shape, bool)
    if index in scene.train_indices or not scene.train_indices:
        return unseen
    rays, valid = scene.camera(index).rays()
    few = np.zeros(alpha.shape, bool)
    few[_EVERY // 2 :: _EVERY, _EVERY // 2 :: _EVERY] = True
    rows, columns = np.nonzero(few & valid)
    opaque = alpha[rows, columns] >= OPAQUE
    distances = np.asarray(rendered.depth)[rows, columns] / np.where(
        opaque, alpha[rows, columns], 1.0
    )
    pose = scene.views[index].camera_from_world
    directions = rays[rows, columns] @ pose[:3, :3]
    origin = -pose[:3, :3].T @ pose[:3, 3]
    points = np.where(opaque[:, None], origin + directions * distances[:, None], directions)
    left = _follow_into_training_views(scene, origin, points, opaque)
    coarse = np.zeros(alpha.shape, bool)
    coarse[rows[left], columns[left]] = True
    return _spread_over_cells(coarse)


def _follow_into_training_views(
    scene: Any, origin: np.ndarray, points: np.ndarray, is_near: np.ndarray
) -> np.ndarray:
    """Returns the indices of the points (N, 3), or directions, that no training view shows."""
    left = np.arange(len(points))
    views = [scene.views[index] for index in scene.train_indices]
    order = np.argsort(
        [np.linalg.norm(view.camera_center - origin) for view in views], kind="stable"
    )
    for number in order:
        if len(left) == 0:
            break
        index = scene.train_indices[number]
        pose, camera = views[number].camera_from_world, scene.camera(index)
        pixels, is_there = camera.project(
            points[left] @ pose[:3, :3].T + is_near[left, None] * pose[:3, 3]
        )
        column, row = np.floor(np.nan_to_num(pixels, nan=-1.0)).astype(np.int64).T
        is_there &= (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
        left = left[~is_there]
    return left


def _spread_over_cells(coarse: np.ndarray) -> np.ndarray:
    """Gives the pixels around each followed ray what was found for it."""
    found = coarse[_EVERY // 2 :: _EVERY, _EVERY // 2 :: _EVERY]
    full = np.kron(found, np.ones((_EVERY, _EVERY), bool))
    rows, columns = np.minimum(full.shape, coarse.shape)
    out = np.zeros(coarse.shape, bool)
    out[:rows, :columns] = full[:rows, :columns]
    return out
