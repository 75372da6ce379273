"""Solves for one lens with mrcal-calibrate-cameras: radial-tangential or splined."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from calib.boards import Board, Photograph
from calib.camera import LENSES, CameraSolution, compose
from calib.errors import SolveError
from calib.solve.mrcal_process import ask, calibrate_cameras, require_mrcal
from calib.solve.opencv_solver import solve_by_opencv
from calib.solve.splined_fit import fit_splined_params, name_splined_model

MRCAL_LENSES = ("opencv4", "opencv8", "splined")
# Between knots of the spline at the axis. Finer knots follow the corners' noise: on real fisheyes
# the residuals keep falling while the error on unseen boards rises.
FINEST_KNOTS_DEGREES = 16.0
COARSE_KNOTS_DEGREES = 40.0  # what `auto` tries: still follows any smooth lens
_GOOD_START_PX = 5.0  # RMS of OpenCV's lens above which it has found a wrong minimum
_CORNERS_A_KNOT = 12  # within the boards' reach, so that noise does not bend the spline


def solve_by_mrcal(
    photographs: Sequence[Photograph],
    board: Board,
    lens: str,
    knot_degrees: float | None = None,
    model: str | None = None,
) -> CameraSolution:
    """Solves for one camera; mrcal's own rule rejects outliers.

    Args:
        photographs: of one camera, all with corners. board: the chessboard.
        lens: one of MRCAL_LENSES.
        knot_degrees: between the knots of a splined lens; None: `choose_knot_pitch`.
        model: mrcal's full name of the lens; None: from the other arguments.

    Raises:
        BoardError: mrcal is not installed.
        SolveError: mrcal failed.
    """
    require_mrcal()
    fisheye = solve_by_opencv(photographs, board, "fisheye")
    model = model or LENSES[lens][1]
    if model == LENSES["splined"][1]:
        model = name_splined_model(fisheye, knot_degrees or choose_knot_pitch(fisheye, board))
    names = [f"camera0-{index:05d}.jpg" for index in range(len(photographs))]
    focal = float(np.mean(fisheye.params[:2]))
    text = calibrate_cameras(str(model), [photographs], [names], [focal], board)
    start: CameraSolution | None
    if lens == "splined":
        # mrcal pulls its splines towards 0 around the centre and focal length that it has guessed
        # and then holds: with the fisheye's own there is less to pull.
        params = fit_splined_params(fisheye, str(model))
        start = dataclasses.replace(fisheye, params=np.array(params))
    else:
        start = _start_by_opencv(photographs, board, lens)
    if start is None:
        found = ask({"do": "describe_solve", "model": text})["cameras"][0]
    else:
        found = solve_again(text, [start], start.camera_from_board, [0.0, 0.0])[0]
    alone = dataclasses.replace(fisheye, lens=lens, solver="mrcal")
    return update_camera(alone, names, found)


def solve_again(
    text: str,
    cameras: Sequence[CameraSolution],
    boards: np.ndarray,
    warp: Sequence[float],
    hold_lenses: bool = False,
) -> list[dict]:
    """Repeats the solve that a .cameramodel holds, from these lenses and poses.

    Args:
        text: of the .cameramodel. cameras: lenses and poses to start from.
        boards: (B, 6) reference from board, by the number in the images' names.
        warp: of the board. hold_lenses: keep the lenses and the warp as they are.

    Returns:
        A description of each camera, see inside_mrcal.py.
    """
    question = {
        "do": "solve_again",
        "model": text,
        "params": [camera.params for camera in cameras],
        "sizes": [[camera.width, camera.height] for camera in cameras],
        "poses": [camera.camera_from_reference for camera in cameras],
        "boards": boards,
        "warp": list(warp),
        "hold_lenses": hold_lenses,
    }
    return ask(question)["cameras"]


def update_camera(camera: CameraSolution, names: Sequence[str], found: dict) -> CameraSolution:
    """Returns the camera as mrcal's solve found it; mrcal orders the images in its own way."""
    order = [found["images"].index(name) for name in names]
    pose = np.array(found["camera_from_reference"])
    boards = np.array(found["reference_from_board"])[order]
    return dataclasses.replace(
        camera,
        model=found["model"],
        params=np.array(found["params"]),
        camera_from_reference=pose,
        camera_from_board=np.stack([compose(pose, board) for board in boards]),
        residuals=np.array(found["residuals"])[order],
        outliers=np.array(found["outliers"], bool)[order],
        model_text=found["text"],
        warp=found["warp"],
    )


def _start_by_opencv(
    photographs: Sequence[Photograph], board: Board, lens: str
) -> CameraSolution | None:
    """Solves for the same kind of lens with OpenCV; returns None if the result is poor."""
    try:
        start = solve_by_opencv(photographs, board, lens)
    except SolveError:
        return None
    return start if start.rms_2d_px <= _GOOD_START_PX else None


def choose_knot_pitch(fisheye: CameraSolution, board: Board) -> float:
    """Chooses the degrees between knots: FINEST_KNOTS_DEGREES, or more if corners are few."""
    angles = fisheye.measure_field_angles(board)[~fisheye.outliers]
    reach = 2 * np.tan(np.max(angles) / 2)
    knots = np.sum(~fisheye.outliers) / _CORNERS_A_KNOT
    pitch = 2 * np.degrees(np.arctan(reach * np.sqrt(np.pi / knots) / 2))
    return float(max(pitch, FINEST_KNOTS_DEGREES))
