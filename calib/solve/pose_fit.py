"""Fits the poses of boards and cameras to solved lenses."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.camera import (
    CameraSolution,
    Observation,
    State,
    make_projector,
    minimize,
    transform_points,
)


def fit_poses(
    cameras: Sequence[CameraSolution],
    observations: Sequence[Observation],
    camera_poses: np.ndarray,
    board_poses: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Fits the poses of the boards, and of all cameras but the first, with the lenses held.

    Args:
        cameras: their lenses. observations: corners to fit.
        camera_poses: (C, 6) camera from reference, board_poses (B, 6) reference from board: starts.

    Returns:
        The fitted camera poses and board poses.

    Raises:
        SolveError: a lens has no image of a corner.
    """
    state = State([camera.params for camera in cameras], camera_poses, board_poses)
    lenses = [make_projector(camera) for camera in cameras]
    state = minimize(state, observations, lenses, free_cameras=len(cameras) > 1)
    return state.cameras, state.boards


def compute_residuals(
    cameras: Sequence[CameraSolution],
    observations: Sequence[Observation],
    camera_poses: np.ndarray,
    board_poses: np.ndarray,
) -> list[np.ndarray]:
    """Computes predicted minus observed pixels (N, 2) of each observation."""
    residuals = []
    for seen in observations:
        camera = cameras[seen.camera]
        in_reference = transform_points(board_poses[seen.board], seen.points)
        points = transform_points(camera_poses[seen.camera], in_reference)
        residuals.append(make_projector(camera)(camera.params, points)[0] - seen.pixels)
    return residuals
