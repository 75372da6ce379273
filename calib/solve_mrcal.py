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

LENS_NAMES = ("opencv4", "opencv8", "splined")
_SPLINE_ORDER = 3
# Between knots of the spline at the axis. Finer knots follow the corners' noise: on real fisheyes
# the residuals keep falling, the error on unseen boards rises (see README.md).
FINEST_KNOTS_DEGREES = 16.0
# Coarse enough for a smooth lens; what `auto` tries.
COARSE_KNOTS_DEGREES = 40.0
_GOOD_START_PX = 5.0  # RMS of OpenCV's lens: above it, it has found a wrong minimum
_CORNERS_A_KNOT = 12  # within the boards' reach, at least
_FEWEST_KNOTS = 6  # each way: a cubic patch and one more on either side
_SPLINE_MARGIN = 1.04  # of the field beyond the image's edge
_WIDEST_DEGREES = 320.0  # of the splined field: the projection ends at 360


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
        text = (folder / "camera-0.cameramodel").read_text()
    if lens != "splined":
        text = _from_opencv(text, photographs, board, lens)
    return from_model_text(text, lens, photographs)


def _from_opencv(text: str, photographs: Sequence[Photograph], board: Board, lens: str) -> str:
    """The solve again, started from OpenCV's lens of the same kind where there is one.

    mrcal-calibrate-cameras starts at random, and the minima of a rational lens are many: some runs
    end in a lens with a pole in the middle of the image, others of the same boards do not.
    """
    try:
        start = solve_opencv.solve_camera(photographs, board, lens)
    except SolveError:
        return text
    if start.rms_2d_px > _GOOD_START_PX:
        return text
    question = {
        "do": "solve_again",
        "models": [text],
        "params": start.params.tolist(),
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


def splined_model(fisheye: CameraSolution, pitch_degrees: float) -> str:
    """mrcal's name of a splined lens that covers the image, its knots a fixed angle apart.

    Args:
        fisheye: the Kannala-Brandt lens of the same boards.
        pitch_degrees: between knots, at the axis.
    """
    fx, fy, cx, cy = fisheye.params[:4]
    half_x = _field_angle(max(cx, fisheye.width - 1 - cx) / fx, fisheye.params[4:])
    half_y = _field_angle(max(cy, fisheye.height - 1 - cy) / fy, fisheye.params[4:])
    degrees = min(2 * np.degrees(half_x) * _SPLINE_MARGIN, _WIDEST_DEGREES)
    # Stereographic u = 2 tan(angle / 2); one cell of a cubic spline lies beyond either edge.
    reach_x, reach_y = 2 * np.tan(np.radians(degrees) / 4), 2 * np.tan(half_y / 2)
    pitch = 2 * np.tan(np.radians(pitch_degrees) / 2)
    columns = max(_FEWEST_KNOTS, int(np.ceil(2 * reach_x / pitch)) + _SPLINE_ORDER)
    pitch = 2 * reach_x / (columns - _SPLINE_ORDER)
    rows = max(_FEWEST_KNOTS, int(np.ceil(2 * reach_y / pitch)) + _SPLINE_ORDER)
    return (
        f"{LENSES['splined'][1]}_order={_SPLINE_ORDER}_Nx={columns}_Ny={rows}"
        f"_fov_x_deg={round(float(degrees))}"
    )


def _field_angle(distorted: float, coefficients: np.ndarray) -> float:
    """Radians at a distorted radius: by the lens where it is one-to-one, else equidistant."""
    angle = np.linspace(0.0, np.pi, 2000)
    radius = angle * (1 + np.polyval([*coefficients[::-1], 0.0], angle**2))
    folds = np.flatnonzero(np.diff(radius) <= 0)
    last = folds[0] if len(folds) else len(radius) - 1
    if distorted <= radius[last]:
        return float(np.interp(distorted, radius[: last + 1], angle[: last + 1]))
    return float(min(max(distorted, angle[last]), np.pi))
