"""The uncertainty of a lens: the standard deviation of where a distant point is projected."""

from __future__ import annotations

import numpy as np

from calib.board import Board
from calib.bundle import Observation, State, covariance
from calib.errors import SolveError
from calib.lens import projector, rays
from calib.mrcal_process import ask
from calib.rigid import skew
from calib.solution import CameraSolution

GRID_COLUMNS = 40  # of the map; its rows follow from the image's shape
UNKNOWN = float("nan")


def spread_pixels(width: int, height: int) -> np.ndarray:
    """(rows, columns, 2) pixels of the map: evenly spread, centre of corner to centre of corner."""
    rows = max(2, round(GRID_COLUMNS * height / width))
    x, y = np.meshgrid(np.linspace(0, width - 1, GRID_COLUMNS), np.linspace(0, height - 1, rows))
    return np.stack([x, y], axis=-1)


def uncertainty_map(camera: CameraSolution, board: Board) -> np.ndarray:
    """(rows, columns) pixels: the standard deviation in its worst direction, of a point far away.

    The noise of the corners, taken from the residuals, is propagated to the lens and the boards'
    poses and from there to the projection of a direction that stays fixed to the boards: a lens
    that is turned together with all boards is the same lens. mrcal's method; by mrcal's own code
    for its solves, by `projection_sigma` for OpenCV's. NaN where the lens has no ray.
    """
    pixels = spread_pixels(camera.width, camera.height)
    flat = pixels.reshape(-1, 2)
    if camera.solver == "mrcal":
        question = {"do": "uncertainty", "models": [camera.model_text], "pixels": flat.tolist()}
        sigma = np.array(ask(question)["sigma"], float)
    else:
        _, cov, layout, _ = parameter_covariance(camera, board)
        sigma = projection_sigma(camera, rays(camera, flat), cov, layout.boards)
    return sigma.reshape(pixels.shape[:2])


def parameter_covariance(camera: CameraSolution, board: Board):
    """Standard deviations (K,) of a lens' parameters, the covariance of all unknowns, its layout
    and the noise of a corner's coordinate in pixels; at an OpenCV solution.

    Raises:
        SolveError: the boards do not determine the lens.
    """
    points, bow = board.points(), board.bow()
    observations = [
        Observation(0, index, photograph.corners[good], points[good], bow[good])
        for index, (photograph, good) in enumerate(
            zip(camera.photographs, ~camera.outliers, strict=True)
        )
    ]
    warp = np.zeros(2) if camera.warp is None else np.array(camera.warp)
    state = State([camera.params], np.zeros((1, 6)), camera.camera_from_board, warp)
    cov, layout, noise = covariance(state, observations, [projector(camera)])
    return np.sqrt(np.diag(cov)[: len(camera.params)]), cov, layout, noise


def projection_sigma(
    camera: CameraSolution, directions: np.ndarray, cov: np.ndarray, boards: list[int]
) -> np.ndarray:
    """(N,) pixels: worst-direction deviation at unit rays (N, 3), given the covariance of all."""
    covariance = projection_covariance(camera, directions, cov, boards)
    sigma = np.full(len(directions), UNKNOWN)
    valid = np.all(np.isfinite(covariance), axis=(1, 2))
    sigma[valid] = np.sqrt(np.maximum(np.linalg.eigvalsh(covariance[valid])[:, -1], 0.0))
    return sigma


def projection_covariance(
    camera: CameraSolution, directions: np.ndarray, cov: np.ndarray, boards: list[int]
) -> np.ndarray:
    """(N, 2, 2) square pixels at unit rays (N, 3), given the covariance of all; NaN without a ray.

    q = project(lens + d, v + mean(board rotations) x v).
    """
    count = len(camera.params)
    valid = np.all(np.isfinite(directions), axis=1)
    spread = np.full((len(directions), 2, 2), UNKNOWN)
    if not valid.any():
        return spread
    _, by_point, by_params = projector(camera)(camera.params, directions[valid])
    turn = -by_point @ skew(directions[valid])  # (N, 2, 3) by the mean rotation of the boards
    mean = np.zeros((3, len(cov)))
    for start in boards:
        mean[:, start : start + 3] += np.eye(3) / len(boards)
    select = np.zeros((count, len(cov)))
    select[:, :count] = np.eye(count)
    small = np.concatenate([select, mean])  # (K + 3, unknowns)
    jacobian = np.concatenate([by_params, turn], axis=2)
    spread[valid] = jacobian @ (small @ cov @ small.T) @ np.swapaxes(jacobian, 1, 2)
    return spread


def safe_uncertainty_map(camera: CameraSolution, board: Board) -> tuple[np.ndarray, str]:
    """The map and an empty text, or NaN everywhere and why there is none."""
    try:
        return uncertainty_map(camera, board), ""
    except SolveError as error:
        return np.full(spread_pixels(camera.width, camera.height).shape[:2], UNKNOWN), str(error)
