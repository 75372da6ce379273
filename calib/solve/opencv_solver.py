"""Solves for one lens with OpenCV, then for the board's bend: fisheye or radial-tangential."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import cv2
import numpy as np

import gsut
from calib.boards import FEWEST_BOARDS, Board, Photograph
from calib.camera import (
    LENSES,
    PIXEL_SHIFT,
    CameraSolution,
    Projector,
    State,
    compose,
    find_outliers,
    make_gsut_projector,
    matrix_from_rodrigues,
    minimize,
    observe_boards,
    project_radially,
    transform_points,
)
from calib.errors import MisfitError, SolveError
from gsut.least_squares import ROUNDS

OPENCV_LENSES = ("fisheye", "opencv4", "opencv8")
# First guesses of the focal length over the width: fisheyes of 180 degrees and more, down to tele.
_FOCAL_GUESSES = (1 / np.pi, 0.25, 0.5, 0.8, 1.2, 2.5)
_STOP = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 200, 1e-10)  # steps, relative change
_GOOD_START_PX = 2.0  # RMS with all corners above which a start has found a wrong minimum
_LEAST_FITTING = 0.5  # share of a board's corners; below it the board's pose is wrong
_PARTS = (0.8, 0.6, 0.4, 0.25)  # of the boards, innermost first, to try if all together fail
# Flags of fisheye solutions: OpenCV 5 has those of cv2 alone.
_FISHEYE_FLAGS = cv2.fisheye if hasattr(cv2.fisheye, "CALIB_FIX_SKEW") else cv2
# Beyond the boards that they were fitted to, high coefficients bend a lens away: combinations of
# coefficients to hold at 0 until the outer boards are in.
_HELD_AT_ZERO = (
    _FISHEYE_FLAGS.CALIB_FIX_K3 | _FISHEYE_FLAGS.CALIB_FIX_K4,
    _FISHEYE_FLAGS.CALIB_FIX_K2 | _FISHEYE_FLAGS.CALIB_FIX_K3 | _FISHEYE_FLAGS.CALIB_FIX_K4,
)
_STEEPEST = np.radians(80.0)  # field angle up to which a fisheye gives the start of a radial lens


def solve_by_opencv(photographs: Sequence[Photograph], board: Board, lens: str) -> CameraSolution:
    """Solves for one camera, rejects outliers and solves again until none is new.

    Args:
        photographs: of one camera, all with corners. board: the chessboard.
        lens: one of OPENCV_LENSES.

    Raises:
        SolveError: OpenCV finds no lens that fits.
    """
    first = photographs[0]
    observed = np.stack([photograph.corners for photograph in photographs])
    size = (first.width, first.height)
    keep = np.ones(observed.shape[:2], bool)
    guess = None
    for _ in range(ROUNDS):
        params, poses = _fit(observed, keep, board, size, lens, guess)
        guess = params
        params, poses, warp = _solve_with_warp(params, poses, observed, keep, board, lens, size)
        residuals = _compute_residuals(
            params, poses, observed, board.locate_corners(warp), lens, size
        )
        again = ~find_outliers(residuals)
        _require_whole_boards(again, photographs, lens)
        if np.array_equal(again, keep):
            break
        keep = again
    return CameraSolution(
        name=first.camera,
        lens=lens,
        solver="opencv",
        width=first.width,
        height=first.height,
        model=LENSES[lens][1] or "KANNALA_BRANDT",
        params=params,
        camera_from_reference=np.zeros(6),
        photographs=list(photographs),
        camera_from_board=poses,
        residuals=residuals,
        outliers=~keep,
        warp=warp.tolist(),
    )


def _solve_with_warp(
    params: np.ndarray,
    poses: np.ndarray,
    observed: np.ndarray,
    keep: np.ndarray,
    board: Board,
    lens: str,
    size: tuple[int, int],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Solves for lens, poses and the board's warp, from OpenCV's solution for a flat board.

    A printed board bends. A bow of 0.4 mm in a board of 20 cm, taken for flat, moves the centre of
    projection by 1 mm and turns the rays at 70 degrees by 0.3 degrees (fisheye) to 0.9 (opencv8).
    """
    left = _compute_residuals(params, poses, observed, board.locate_corners(), lens, size)
    keep = keep & np.isfinite(left).all(axis=-1)
    observations = observe_boards(observed, keep, board)
    project = _make_projector(lens, size)
    state = State([params], np.zeros((1, 6)), poses)
    state = minimize(state, observations, [project], free_params=True)
    return state.params[0], state.boards, state.warp


def _find_lost_boards(good: np.ndarray) -> list[int]:
    """Finds boards that lost half of their corners: poses are wrong, or these are no boards."""
    return [int(index) for index in np.flatnonzero(good.mean(axis=1) < _LEAST_FITTING)]


def _require_whole_boards(good: np.ndarray, photographs: Sequence[Photograph], lens: str) -> None:
    lost = _find_lost_boards(good)
    if lost:
        raise MisfitError(
            f"{photographs[lost[0]].path}: its corners do not fit the {lens} lens of the other "
            "boards; leave it out, or try another --lens",
            lost,
        )


def _fit(
    observed: np.ndarray,
    keep: np.ndarray,
    board: Board,
    size: tuple[int, int],
    lens: str,
    guess: np.ndarray | None,
) -> tuple[np.ndarray, np.ndarray]:
    """Fits parameters (K,) and poses (V, 6) to the corners kept, on a flat board."""
    if lens == "fisheye":
        return _fit_fisheye(observed, keep, board, size, guess)
    if guess is None:
        guess = _guess_radial_lens(observed, keep, board, size, lens)
    flags = cv2.CALIB_USE_INTRINSIC_GUESS
    flags |= cv2.CALIB_RATIONAL_MODEL if lens == "opencv8" else cv2.CALIB_FIX_K3
    points = board.locate_corners().astype(np.float32)
    try:
        rms, matrix, distortion, rotations, translations, *_ = cv2.calibrateCameraExtended(
            [points[k] for k in keep],
            [o[k].astype(np.float32) for o, k in zip(observed, keep, strict=True)],
            size,
            _build_matrix(guess),
            np.concatenate([guess[4:], np.zeros(8)])[: 8 if lens == "opencv8" else 5],
            flags=flags,
            criteria=_STOP,
        )
    except cv2.error as error:
        raise SolveError(_describe_failure(lens, error)) from None
    if not np.isfinite(rms):
        raise SolveError(_describe_failure(lens, "the residuals are not finite"))
    return (
        _collect_params(matrix, distortion.ravel()[: LENSES[lens][2]]),
        np.hstack([np.reshape(rotations, (-1, 3)), np.reshape(translations, (-1, 3))]),
    )


def _fit_fisheye(observed, keep, board, size, guess) -> tuple[np.ndarray, np.ndarray]:
    """Fits with OpenCV; if that fails, fits inner boards first and adds the others afterwards.

    cv2.fisheye starts each board's pose on a plane in front of the camera, so that one corner at 90
    degrees makes it fail; `minimize` has no such plane.
    """
    try:
        params, poses = _fit_fisheye_at_once(observed, keep, board, size, guess)
        left = _compute_residuals(params, poses, observed, board.locate_corners(), "fisheye", size)
        if not _find_lost_boards(~find_outliers(left)):
            return params, poses
        fallback = params, poses
        problem = None
    except SolveError as error:
        fallback, problem = None, error
    centre = (np.array(size) - 1) / 2
    outermost = [np.linalg.norm(o - centre, axis=1).max() for o in observed]
    order = np.argsort(outermost)
    for part, held in itertools.product(_PARTS, _HELD_AT_ZERO):
        inner = order[: max(FEWEST_BOARDS, int(part * len(order)))]
        try:
            params, _ = _fit_fisheye_at_once(observed[inner], keep[inner], board, size, None, held)
            return _refine(params, observed, keep, board, size)
        except SolveError:
            continue
    if fallback is not None:
        return fallback
    raise problem


def _refine(params, observed, keep, board, size) -> tuple[np.ndarray, np.ndarray]:
    """Refines lens and all boards together, from a lens that the inner boards gave."""
    points, project = board.locate_corners(), _make_projector("fisheye", size)
    centre = params[2:4] + PIXEL_SHIFT
    lens = gsut.Camera("kannala_brandt", [*params[:2], *centre, *params[4:]], *size)
    poses = []
    for pixels, good in zip(observed, keep, strict=True):
        directions, valid = lens.unproject(pixels[good] + PIXEL_SHIFT)
        if not valid.all():
            raise SolveError("a corner lies outside the lens of the inner boards")
        poses.append(_estimate_board_pose(points[good], directions))
    observations = observe_boards(observed, keep, board)
    state = State([params], np.zeros((1, 6)), np.stack(poses))
    state = minimize(state, observations, [project])
    state = minimize(state, observations, [project], free_params=True)
    return state.params[0], state.boards


def _estimate_board_pose(points: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Estimates the pose (6,) of a board seen along unit rays (N, 3).

    The camera is first turned towards the board, where a plane in front of it serves.
    """
    middle = directions.mean(axis=0)
    middle /= np.linalg.norm(middle)
    axis = np.cross([0.0, 0.0, 1.0], middle)
    sine = np.linalg.norm(axis)
    turn = axis / max(sine, 1e-12) * np.arctan2(sine, middle[2])
    ahead = directions @ matrix_from_rodrigues(turn)
    _, rotation, translation = cv2.solvePnP(
        points, ahead[:, :2] / ahead[:, 2:], np.eye(3), None, flags=cv2.SOLVEPNP_IPPE
    )
    return compose(np.append(turn, np.zeros(3)), np.concatenate([rotation, translation]).ravel())


def _fit_fisheye_at_once(
    observed, keep, board, size, guess, held=0
) -> tuple[np.ndarray, np.ndarray]:
    flags = held | (
        _FISHEYE_FLAGS.CALIB_RECOMPUTE_EXTRINSIC
        | _FISHEYE_FLAGS.CALIB_FIX_SKEW
        | _FISHEYE_FLAGS.CALIB_USE_INTRINSIC_GUESS
    )
    points = [board.locate_corners()[k][None] for k in keep]
    pixels = [o[k][None] for o, k in zip(observed, keep, strict=True)]
    centre = [(size[0] - 1) / 2, (size[1] - 1) / 2]
    starts = (
        [guess]
        if guess is not None
        else [
            np.array([f * size[0], f * size[0], *centre, 0, 0, 0, 0], float) for f in _FOCAL_GUESSES
        ]
    )
    best, problem = None, "every start diverged"
    for start in starts:
        try:
            rms, matrix, distortion, rotations, translations = cv2.fisheye.calibrate(
                points,
                pixels,
                size,
                _build_matrix(start),
                start[4:].copy(),
                flags=flags,
                criteria=_STOP,
            )
        except cv2.error as error:  # a start so far off that a board has no pose
            problem = error
            continue
        if np.isfinite(rms) and (best is None or rms < best[0]):
            best = (rms, matrix, distortion, rotations, translations)
            if rms < _GOOD_START_PX:
                break
    if best is None:
        raise SolveError(_describe_failure("fisheye", problem))
    _, matrix, distortion, rotations, translations = best
    poses = np.hstack([np.reshape(rotations, (-1, 3)), np.reshape(translations, (-1, 3))])
    return _collect_params(matrix, distortion.ravel()), poses


def _guess_radial_lens(observed, keep, board, size, lens) -> np.ndarray:
    """Guesses a radial-tangential lens from the fisheye that fits: linear in the coefficients.

    r (1 + k1 r^2 + ...) = d (1 + k4 r^2 + ...) with r = tan(angle) and d of the fisheye.
    """
    params, _ = _fit_fisheye(observed, keep, board, size, None)
    angle = np.linspace(0.01, 1.0, 100) * _STEEPEST
    distorted = angle * (1 + np.polyval([*params[7:3:-1], 0.0], angle**2))
    distorted = np.where(np.gradient(distorted) > 0, distorted, np.nan)
    use = np.isfinite(distorted)
    r = np.tan(angle[use])
    d = distorted[use]
    weight = np.cos(angle[use]) ** 2  # else the last degrees, where r runs away, would dominate
    if lens == "opencv8":
        columns = [r**3, r**5, r**7, -d * r**2, -d * r**4, -d * r**6]
    else:
        columns = [r**3, r**5]
        weight = weight**2
    design = np.stack(columns, axis=1)
    fit = np.linalg.lstsq(design * weight[:, None], (d - r) * weight, rcond=None)[0]
    return np.concatenate([params[:4], fit[:2], [0.0, 0.0], fit[2:]])


def _make_projector(lens: str, size: tuple[int, int]) -> Projector:
    if lens == "fisheye":  # by gsut: OpenCV's is wrong behind the camera
        return make_gsut_projector(LENSES[lens][0], *size)
    return project_radially


def _compute_residuals(params, poses, observed, points, lens, size) -> np.ndarray:
    project = _make_projector(lens, size)
    predicted = [project(params, transform_points(pose, points))[0] for pose in poses]
    return np.stack(predicted) - observed


def _build_matrix(params: np.ndarray) -> np.ndarray:
    fx, fy, cx, cy = params[:4]
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def _collect_params(matrix: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    return np.array([matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *coefficients])


def _describe_failure(lens: str, problem: object) -> str:
    lines = str(problem).strip().splitlines()
    return (
        f"OpenCV found no {lens} lens that fits these boards ({lines[-1] if lines else problem}); "
        "try another --lens or --solver mrcal, and look at the pictures of the corners"
    )
