"""Estimates the uncertainty of a lens: the standard deviation of where it projects a point."""

from __future__ import annotations

import numpy as np

from calib.boards import Board
from calib.camera import (
    PIXEL_SHIFT,
    CameraSolution,
    State,
    cross_matrix_from_vector,
    estimate_covariance,
    make_projector,
    observe_boards,
    unproject_pixels,
)
from calib.errors import SolveError
from calib.solve import ask
from gsut import lens

UNKNOWN = float("nan")


def spread_pixels(width: int, height: int) -> np.ndarray:
    """Places the pixels (rows, columns, 2) of the map evenly, corner centre to corner centre."""
    return lens.spread_pixels(width, height) - PIXEL_SHIFT


def map_uncertainty(camera: CameraSolution, board: Board) -> np.ndarray:
    """Maps (rows, columns) the standard deviation in pixels of a distant point's projection.

    The noise of the corners, taken from the residuals, is propagated to the lens and the boards'
    poses, and from there to the projection of a direction that stays fixed to the boards: a lens
    that turns together with all boards is the same lens. This is mrcal's method, done by its own
    code for its solves and by `estimate_projection_sigma` for OpenCV's. The value is that of the
    worst direction in the image; NaN where the lens has no ray.
    """
    pixels = spread_pixels(camera.width, camera.height)
    flat = pixels.reshape(-1, 2)
    if camera.solver == "mrcal":
        question = {"do": "estimate_uncertainty", "model": camera.model_text, "pixels": flat}
        sigma = np.array(ask(question)["sigma"], float)
    else:
        _, cov, layout, _ = estimate_parameter_covariance(camera, board)
        sigma = estimate_projection_sigma(
            camera, unproject_pixels(camera, flat), cov, layout.boards
        )
    return sigma.reshape(pixels.shape[:2])


def estimate_parameter_covariance(camera: CameraSolution, board: Board):
    """Estimates standard deviations (K,) of a lens' parameters at an OpenCV solution.

    Also returns the covariance of all unknowns, its layout, and the noise of a corner's coordinate
    in pixels.

    Raises:
        SolveError: the boards do not determine the lens.
    """
    observations = observe_boards(camera.corners, ~camera.outliers, board)
    warp = np.zeros(2) if camera.warp is None else np.array(camera.warp)
    state = State([camera.params], np.zeros((1, 6)), camera.camera_from_board, warp)
    cov, layout, noise = estimate_covariance(state, observations, [make_projector(camera)])
    return np.sqrt(np.diag(cov)[: len(camera.params)]), cov, layout, noise


def estimate_projection_sigma(
    camera: CameraSolution, directions: np.ndarray, cov: np.ndarray, boards: list[int]
) -> np.ndarray:
    """Estimates the deviation (N,) in pixels, in the worst direction, at unit rays (N, 3).

    Args:
        camera: the lens. directions: the rays. cov: covariance of all unknowns.
        boards: where each board's pose begins in it.
    """
    covariance = propagate_covariance(camera, directions, cov, boards)
    sigma = np.full(len(directions), UNKNOWN)
    valid = np.all(np.isfinite(covariance), axis=(1, 2))
    sigma[valid] = np.sqrt(np.maximum(np.linalg.eigvalsh(covariance[valid])[:, -1], 0.0))
    return sigma


def propagate_covariance(
    camera: CameraSolution, directions: np.ndarray, cov: np.ndarray, boards: list[int]
) -> np.ndarray:
    """Propagates the covariance of all unknowns to pixels (N, 2, 2) at unit rays (N, 3).

    q = project(lens + d, v + mean(board rotations) x v); NaN without a ray. The arguments are those
    of `estimate_projection_sigma`.
    """
    count = len(camera.params)
    valid = np.all(np.isfinite(directions), axis=1)
    spread = np.full((len(directions), 2, 2), UNKNOWN)
    if not valid.any():
        return spread
    _, by_point, by_params = make_projector(camera)(camera.params, directions[valid])
    # (N, 2, 3) by the mean rotation of the boards
    turn = -by_point @ cross_matrix_from_vector(directions[valid])
    mean = np.zeros((3, len(cov)))
    for start in boards:
        mean[:, start : start + 3] += np.eye(3) / len(boards)
    select = np.zeros((count, len(cov)))
    select[:, :count] = np.eye(count)
    small = np.concatenate([select, mean])  # (K + 3, unknowns)
    jacobian = np.concatenate([by_params, turn], axis=2)
    spread[valid] = jacobian @ (small @ cov @ small.T) @ np.swapaxes(jacobian, 1, 2)
    return spread


def map_uncertainty_if_possible(camera: CameraSolution, board: Board) -> tuple[np.ndarray, str]:
    """Returns the map and an empty text, or NaN everywhere and why there is no map."""
    try:
        return map_uncertainty(camera, board), ""
    except SolveError as error:
        return np.full(spread_pixels(camera.width, camera.height).shape[:2], UNKNOWN), str(error)
