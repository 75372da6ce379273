"""Fits boards and camera poses to solved lenses, in this process or inside mrcal's."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.bundle import Observation, State, minimise
from calib.lens import projector
from calib.mrcal_process import ask
from calib.rigid import transform_points
from calib.solution import CameraSolution


def fit_poses(
    cameras: Sequence[CameraSolution],
    observations: Sequence[Observation],
    camera_poses: np.ndarray,
    board_poses: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Poses of the boards, and of all cameras but the first, with the lenses held.

    Args:
        cameras: their lenses, all solved with the same kind. observations: corners to fit.
        camera_poses: (C, 6) camera from reference, board_poses (B, 6) reference from board: starts.

    Returns:
        The same, fitted.
    """
    if cameras[0].lens != "splined":
        state = State([camera.params for camera in cameras], camera_poses, board_poses)
        lenses = [projector(camera) for camera in cameras]
        state = minimise(state, observations, lenses, free_cameras=len(cameras) > 1)
        return state.cameras, state.boards
    answer = ask(
        {
            "do": "fit_boards",
            "models": [camera.model_text for camera in cameras],
            "cameras": camera_poses.tolist(),
            "boards": board_poses.tolist(),
            "observations": [_plain(observation) for observation in observations],
        }
    )
    return np.array(answer["cameras"]), np.array(answer["boards"])


def project(camera: CameraSolution, points: np.ndarray) -> np.ndarray:
    """Pixels (N, 2) of points (N, 3) in the camera's frame, as the solver's formula has them."""
    if camera.lens != "splined":
        return projector(camera)(camera.params, points)[0]
    question = {"do": "project", "models": [camera.model_text], "points": points.tolist()}
    return np.array(ask(question)["pixels"]).reshape(-1, 2)


def residuals(
    cameras: Sequence[CameraSolution],
    observations: Sequence[Observation],
    camera_poses: np.ndarray,
    board_poses: np.ndarray,
) -> list[np.ndarray]:
    """(N, 2) predicted - observed pixels of each observation."""
    points = [
        transform_points(camera_poses[o.camera], transform_points(board_poses[o.board], o.points))
        for o in observations
    ]
    found: list[np.ndarray] = [np.empty(0)] * len(observations)
    for index, camera in enumerate(cameras):
        mine = [i for i, o in enumerate(observations) if o.camera == index]
        if not mine:
            continue
        pixels = project(camera, np.concatenate([points[i] for i in mine]))
        ends = np.cumsum([len(points[i]) for i in mine])[:-1]
        for i, part in zip(mine, np.split(pixels, ends), strict=True):
            found[i] = part - observations[i].pixels
    return found


def _plain(observation: Observation) -> dict:
    return {
        "camera": observation.camera,
        "board": observation.board,
        "pixels": observation.pixels.tolist(),
        "points": observation.points.tolist(),
    }
