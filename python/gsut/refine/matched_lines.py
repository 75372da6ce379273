"""Poses the lines of a rolling shutter from matches of a photograph with places in the scene."""

from __future__ import annotations

from typing import Any

import numpy as np

from gsut._core import Shutter, moved_pose
from gsut.least_squares import minimize_least_squares
from gsut.refine.pixel_rows import POSE, find_line_times

# Step of a difference, in radians and in distances of the places.
_DIFFERENCE = 1e-6
# Steps at most; a handful suffices.
_STEPS = 30
# Share of the cost that a step must gain to be followed by another.
_LEAST_GAIN = 1e-4


def find_line_poses(
    camera: Any,
    shutter: Shutter,
    pose: np.ndarray,
    pixels: np.ndarray,
    places: np.ndarray,
    max_error: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Finds the pose in the middle of a readout and the motion during it.

    Args:
        camera: the photograph's lens. shutter: how its lines are read.
        pose: (4, 4) camera_from_world to start from, that of a global shutter.
        pixels: (n, 2) of the photograph. places: (n, 3) where the scene shows the same.
        max_error: distance in pixels beyond which a match counts less (Huber), and not as agreeing.

    Returns:
        The pose (4, 4), the motion (6,) of `SecantPose`, and (n,) bool, which matches agree.
    """
    size = [camera.width - 1, camera.height - 1]
    column, row = np.clip(pixels.astype(np.int64), 0, size).T
    flat = row * camera.width + column
    times, line = np.unique(
        find_line_times(shutter, flat, camera.width, camera.height), return_inverse=True
    )
    center = -pose[:3, :3].T @ pose[:3, 3]
    distance = float(np.median(np.linalg.norm(places - center, axis=1)))
    unit = np.tile(np.repeat([distance, 1.0], 3), 2)

    def compare(at: np.ndarray) -> np.ndarray:
        moves = at * unit
        middle = moved_pose(pose, moves[:POSE], 1.0)
        lines = np.stack([moved_pose(middle, moves[POSE:], time) for time in times])[line]
        seen, valid = camera.project(np.einsum("nij,nj->ni", lines[:, :3, :3], places)
                                     + lines[:, :3, 3])  # fmt: skip
        return np.where(valid[:, None], seen - pixels, np.hypot(*size))

    def compute_cost(at: np.ndarray) -> float:
        length = np.linalg.norm(compare(at), axis=1)
        inner = np.minimum(length, max_error)
        return float(np.sum(inner * (2 * length - inner)))

    def make_normal_equations(at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        off = compare(at)
        weights = max_error / np.maximum(np.linalg.norm(off, axis=1), max_error)
        sides = [compare(at + step) for step in _DIFFERENCE * np.eye(2 * POSE)]
        slopes = np.stack([side - off for side in sides], axis=2) / _DIFFERENCE
        weighted = weights[:, None, None] * slopes
        return (
            np.einsum("nck,nc->k", weighted, off),
            np.einsum("nck,ncl->kl", weighted, slopes),
        )

    at, _ = minimize_least_squares(
        np.zeros(2 * POSE), compute_cost, make_normal_equations,
        max_steps=_STEPS, least_gain=_LEAST_GAIN,
    )  # fmt: skip
    agree = np.linalg.norm(compare(at), axis=1) <= max_error
    moves = at * unit
    return moved_pose(pose, moves[:POSE], 1.0), moves[POSE:], agree
