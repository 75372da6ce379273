"""Motions and scenes that leave an unknown lens open."""

from __future__ import annotations

import math

import numpy as np

from gsut.data.poses import find_centers
from gsut.gaussians import measure_rotation_angles
from gsut.sfm.solution import Solution

# Extent over the next larger one, below which camera centres lie on a line, or points in a plane.
_THIN = 0.03
_LITTLE_TURN = math.radians(10.0)  # between the views: it constrains no lens


def find_critical_motion(solution: Solution) -> str | None:
    """Finds why the motion or the scene leaves the lens open, as a sentence; None if nothing does.

    A straight flight without turns: a longer focal length with a longer path gives the same images.
    A plane seen from one height: no depth differences, so that focal length and height trade off
    (Sturm, "Critical motion sequences for monocular self-calibration", CVPR 1997).
    """
    poses = solution.camera_from_world[solution.registered]
    extents = _measure_extents(find_centers(poses))
    middle = poses[len(poses) // 2, :3, :3]
    angles = measure_rotation_angles(poses[:, :3, :3] @ middle.T)
    still = float(np.percentile(angles, 90)) < _LITTLE_TURN
    if extents[1] < _THIN * extents[0] and still:
        return (
            "the camera moved straight on without turning, so the focal length and the length of "
            "the path along the view can replace each other: film a curve, or turn the camera "
            "while you move, some pictures upright and some on their side"
        )
    flat = _measure_extents(_drop_far_points(solution.points))
    if flat[2] < _THIN * flat[1] and still:
        return (
            "everything seen lies in one plane and was seen from one direction, so focal length "
            "and distance can replace each other: add pictures tilted by 30 degrees or more, or "
            "with things of different height"
        )
    return None


def _drop_far_points(points: np.ndarray) -> np.ndarray:
    """Drops the farthest tenth of the points, as single outliers are no depth."""
    distance = np.linalg.norm(points - np.median(points, axis=0), axis=1)
    return points[distance <= np.percentile(distance, 90)] if len(points) else points


def _measure_extents(points: np.ndarray) -> np.ndarray:
    """Returns (3,) the singular values about the mean, largest first."""
    if len(points) < 3:
        return np.array([1.0, 0.0, 0.0])
    values = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return np.maximum(values, 1e-300 * np.ones(3))
