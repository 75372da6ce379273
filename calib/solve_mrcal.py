"""Solves for lenses with mrcal-calibrate-cameras: radial-tangential and splined-stereographic."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calib import solve_opencv
from calib.board import Board, Photograph
from calib.corner_files import write_vnl
from calib.errors import SolveError
from calib.mrcal_process import ask, calibrate_cameras, require_mrcal
from calib.solution import LENSES, CameraSolution
from calib.splined_fit import nearest_params, splined_model

LENS_NAMES = ("opencv4", "opencv8", "splined")
# Between knots of the spline at the axis. Finer knots follow the corners' noise: on real fisheyes
# the residuals keep falling, the error on unseen boards rises (see README.md).
FINEST_KNOTS_DEGREES = 16.0
# Coarse enough for a smooth lens; what `auto` tries.
COARSE_KNOTS_DEGREES = 40.0
_GOOD_START_PX = 5.0  # RMS of OpenCV's lens: above it, it has found a wrong minimum
_CORNERS_A_KNOT = 12  # within the boards' reach, at least


def solve_camera(
    photographs: Sequence[Photograph],
    board: Board,
    lens: str,
    knot_degrees: float | None = None,
    model: str | None = None,
) -> CameraSolution:
    """One camera; outliers are thrown out by mrcal's own rule.

    Args:
        photographs: of one camera, all with corners. board: the chessboard.
        lens: one of LENS_NAMES.
        knot_degrees: of a splined lens, between knots; None: `knot_pitch`.
        model: mrcal's whole name of the lens; None: from the other arguments.

    Raises:
        BoardError: mrcal is not installed.
        SolveError: mrcal failed.
    """
    require_mrcal()
    first = photographs[0]
    fisheye = solve_opencv.solve_camera(photographs, board, "fisheye")
    model = model or LENSES[lens][1]
    if model == LENSES["splined"][1]:
        model = splined_model(fisheye, knot_degrees or knot_pitch(fisheye, board))
    with tempfile.TemporaryDirectory(prefix="gsut-calib-") as name:
        folder = Path(name)
        names = [f"camera0-{index:05d}.jpg" for index in range(len(photographs))]
        write_vnl(folder / "corners.vnl", photographs, names)
        arguments = {
            "--corners-cache": "corners.vnl",
            "--lensmodel": model,
            "--focal": f"{float(np.mean(fisheye.params[:2])):.3f}",
            "--object-spacing": repr(board.spacing),
            "--object-width-n": str(board.columns),
            "--object-height-n": str(board.rows),
            "--outdir": ".",
        }
        flat = [word for pair in arguments.items() for word in pair]
        size = ["--imagersize", str(first.width), str(first.height)]
        calibrate_cameras([*flat, *size, "camera0-*.jpg"], folder)
        text = (folder / "camera-0.cameramodel").read_text(encoding="utf-8")
    start = fisheye
    if lens != "splined":
        start = _start_by_opencv(photographs, board, lens)
    if start is not None:
        params = start.params.tolist()
        if lens == "splined":
            # mrcal pulls its splines towards 0 around the centre and focal length that it has
            # guessed and then holds: with the fisheye's own there is less to pull.
            params = nearest_params(fisheye, model)
        text = _solved_from(text, params, start)
    return from_model_text(text, lens, photographs)


def _start_by_opencv(
    photographs: Sequence[Photograph], board: Board, lens: str
) -> CameraSolution | None:
    """OpenCV's lens of the same kind, where there is a good one."""
    try:
        start = solve_opencv.solve_camera(photographs, board, lens)
    except SolveError:
        return None
    return start if start.rms_2d_px <= _GOOD_START_PX else None


def _solved_from(text: str, params: list[float], start: CameraSolution) -> str:
    """The solve again, from the parameters and from the boards of `start`.

    mrcal-calibrate-cameras starts at random, and the minima of a rational lens are many: some runs
    end in a lens with a pole in the middle of the image, others of the same boards do not.
    """
    question = {
        "do": "solve_again",
        "models": [text],
        "params": params,
        "boards": start.camera_from_board.tolist(),
    }
    return ask(question)["model"]


def from_model_text(text: str, lens: str, photographs: Sequence[Photograph]) -> CameraSolution:
    """The solution in a .cameramodel with optimization_inputs of one camera alone."""
    first = photographs[0]
    found = ask({"do": "solved", "models": [text]})
    return CameraSolution(
        name=first.camera,
        lens=lens,
        solver="mrcal",
        width=first.width,
        height=first.height,
        model=found["model"],
        params=np.array(found["params"]),
        camera_from_reference=np.zeros(6),
        photographs=list(photographs),
        camera_from_board=np.array(found["camera_from_board"]),
        residuals=np.array(found["residuals"]),
        outliers=np.array(found["outliers"], bool),
        model_text=text,
        warp=found["warp"],
    )


def knot_pitch(fisheye: CameraSolution, board: Board) -> float:
    """Degrees between knots: FINEST_KNOTS_DEGREES, or more where corners are few."""
    reach = 2 * np.tan(np.max(fisheye.field_angles(board)[~fisheye.outliers]) / 2)
    knots = np.sum(~fisheye.outliers) / _CORNERS_A_KNOT
    pitch = 2 * np.degrees(np.arctan(reach * np.sqrt(np.pi / knots) / 2))
    return float(max(pitch, FINEST_KNOTS_DEGREES))
