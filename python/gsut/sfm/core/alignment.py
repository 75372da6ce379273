"""Aligns two sets of points by a similarity, and measures angles between rotations."""

from __future__ import annotations

import numpy as np


def similarity(source: np.ndarray, target: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """The scale, rotation (3, 3) and translation (3,) that carry source points to target ones best.

    Source: Umeyama, "Least-squares estimation of transformation parameters", PAMI 1991.
    """
    source_mean, target_mean = source.mean(axis=0), target.mean(axis=0)
    a, b = source - source_mean, target - target_mean
    left, values, right = np.linalg.svd(b.T @ a)
    sign = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right)) or 1.0])
    rotation = left @ sign @ right
    scale = float((values * np.diag(sign)).sum() / max((a**2).sum(), 1e-300))
    return scale, rotation, target_mean - scale * rotation @ source_mean


def rotation_angles(rotations: np.ndarray) -> np.ndarray:
    """(N,) angles in radians of rotations (N, 3, 3), exact for small ones too."""
    axis = np.stack(
        [
            rotations[:, 2, 1] - rotations[:, 1, 2],
            rotations[:, 0, 2] - rotations[:, 2, 0],
            rotations[:, 1, 0] - rotations[:, 0, 1],
        ],
        axis=1,
    )
    return np.arctan2(np.linalg.norm(axis, axis=1), np.trace(rotations, axis1=1, axis2=2) - 1.0)
