"""Measures the solves of the real board sets: residuals, the rig's pose, agreement of two lenses.

    .venv/bin/python -m tests.bench.measure_boards BOARDS

BOARDS holds fisheye_stereo/ and ocam_fisheye1/ (see README.md).
"""

from __future__ import annotations

import dataclasses
import itertools
import sys
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from calib.boards.board import Board, assign_cameras
from calib.boards.corners import find_boards
from calib.camera.rigid import compose, invert
from calib.camera.solution import CameraSolution
from calib.solve import mrcal_solver, opencv_solver
from calib.solve.mrcal_rig import solve_together
from calib.solve.rig import solve_rig
from calib.trust.halves import AGREEMENT_DEGREES, compare_lenses, find_agreement_angle, solve_halves
from calib.trust.second_lens import compare_with, cut_where_lenses_differ
from calib.trust.trust import judge
from calib.trust.uncertainty import map_uncertainty

_SETS = (
    ("fisheye_stereo", "left", Board(9, 6, 0.02423)),
    ("fisheye_stereo", "right", Board(9, 6, 0.02423)),
    ("ocam_fisheye1", "Fisheye", Board(6, 8, 0.0325)),
)
_SOLVES = (
    (opencv_solver, "fisheye"),
    (opencv_solver, "opencv8"),
    (mrcal_solver, "opencv8"),
    (mrcal_solver, "splined"),
)
_GOOD = ("fisheye by opencv", "opencv8 by mrcal", "splined by mrcal")  # compared in pairs


def measure(folder: Path, prefix: str, board: Board) -> dict[str, CameraSolution]:
    """Solves one camera with every lens and prints a line each, then each pair's difference."""
    photographs = assign_cameras(sorted(folder.glob(f"{prefix}*.jpg")), [])
    find_boards(photographs, board, progress=False)
    found = [photograph for photograph in photographs if photograph.corners is not None]
    print(f"{folder.name} {prefix}: {len(found)} boards in {len(photographs)} photographs")
    solutions = {}
    for solver, lens in _SOLVES:
        camera = solver.solve_camera(found, board, lens)
        solutions[f"{lens} by {camera.solver}"] = camera
    trusts = {}
    for (solver, lens), (name, camera) in zip(_SOLVES, solutions.items(), strict=True):
        trust = judge(camera, board, map_uncertainty(camera, board))
        alone = trust.valid_angle
        pair = solve_halves(
            camera, lambda part, by=solver, lens=lens: by.solve_camera(part, board, lens)
        )
        halves_to = find_agreement_angle(*pair, alone) if pair else None
        others = [
            compare_with(camera, trust, other, board)
            for other in solutions.values()
            if other.lens != lens and (other.lens == "fisheye" or other.solver == "mrcal")
        ]
        cut_where_lenses_differ(trust, halves_to, [other for other in others if other], lens)
        trusts[name] = trust
        degrees = np.degrees([trust.reach, trust.domain, alone, halves_to or np.nan])
        warp = np.array(camera.warp) * 1000
        print(
            f"  {lens:8} by {camera.solver:6}: RMS {camera.rms_2d_px:.4f} px 2-D, "
            f"{camera.rms_axis_px:.4f} an axis, {camera.outliers.sum():2d} outliers; board bent by "
            f"{warp[0]:.2f}, {warp[1]:.2f} mm; boards to {degrees[0]:.1f}, one-to-one to "
            f"{degrees[1]:.1f}, by itself trusted to {degrees[2]:.1f}, halves agree to "
            f"{degrees[3]:.1f}; TRUSTED to {np.degrees(trust.valid_angle):.1f} degrees"
            f"{'; REFUSED' if trust.refusal else ''}"
        )
        for other in filter(None, others):
            to = np.degrees([other.agrees_to, other.agrees_near_to, other.compared_to])
            print(
                f"    {other.lens} by {other.solver} agrees within {AGREEMENT_DEGREES} degree to "
                f"{to[0]:.0f} far away, to {to[1]:.0f} at {other.distance:.2f} m, of {to[2]:.0f}"
            )
    for a, b in itertools.combinations(_GOOD, 2):
        limit = min(trusts[name].valid_angle for name in (a, b))
        worst = compare_lenses(solutions[a], solutions[b], limit).worst_degrees
        print(
            f"  {a} and {b}: {worst:.3f} degree at most in their trusted field "
            f"({np.degrees(limit):.1f} degrees)"
        )
    return solutions


def measure_rig(cameras: Sequence[CameraSolution], board: Board) -> None:
    """The rig's pose against OpenCV's stereo calibration with the same lenses and boards.

    OpenCV takes whole boards, and no corner out. Therefore twice: all boards, with outliers; and
    those without an outlier in either image, which leaves other boards and another pose: these
    photographs were not quite simultaneous.
    """
    clean = [
        index
        for index in range(len(cameras[0].photographs))
        if not any(camera.outliers[index].any() for camera in cameras)
    ]
    every = list(range(len(cameras[0].photographs)))
    for boards in (every, clean):
        some = [_only(camera, boards) for camera in cameras]
        solve_rig(some, board)
        _compare_rig(f"{some[0].lens}, lenses held", some, board)
        if some[0].solver == "mrcal":
            for hold in (True, False):
                name = f"{some[0].lens}, mrcal's joint solve, lenses {'held' if hold else 'free'}"
                _compare_rig(name, solve_together(some, board, hold), board)


def _compare_rig(name: str, cameras: Sequence[CameraSolution], board: Board) -> None:
    pose, theirs = cameras[1].camera_from_reference, by_stereo_calibrate(*cameras, board)
    error = compose(pose, invert(theirs))
    print(
        f"rig, {name}, {len(cameras[0].photographs)} boards in both: "
        f"{np.linalg.norm(pose[3:]) * 1000:.2f} mm apart; from OpenCV's stereo calibration "
        f"{np.degrees(np.linalg.norm(error[:3])):.4f} degree, "
        f"{np.linalg.norm(pose[3:] - theirs[3:]) * 1000:.4f} mm"
    )


def by_stereo_calibrate(first: CameraSolution, second: CameraSolution, board: Board) -> np.ndarray:
    """(6,) second camera from the first by OpenCV: all their boards whole, bent as the first
    camera's solve found, the lenses held."""
    fisheye = first.lens == "fisheye"
    lenses = []
    for camera in (first, second):
        fx, fy, cx, cy = camera.params[:4]
        lenses += [np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]]), camera.params[4:].copy()]
    kind = np.float64 if fisheye else np.float32  # what OpenCV's two functions take
    points = board.locate_corners(first.warp).astype(kind)[None]
    corners = [
        [photograph.corners.astype(kind)[None] for photograph in camera.photographs]
        for camera in (first, second)
    ]
    solve = cv2.fisheye.stereoCalibrate if fisheye else cv2.stereoCalibrate
    flags = cv2.CALIB_FIX_INTRINSIC | cv2.CALIB_RATIONAL_MODEL
    answer = solve(
        [points] * len(corners[0]),
        *corners,
        *lenses,
        (first.width, first.height),
        flags=cv2.fisheye.CALIB_FIX_INTRINSIC if fisheye else flags,
        criteria=(cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 300, 1e-12),
    )
    return np.concatenate([cv2.Rodrigues(answer[5])[0].ravel(), answer[6].ravel()])


def _only(camera: CameraSolution, indices: list[int]) -> CameraSolution:
    """The solution with some of its photographs."""
    return dataclasses.replace(
        camera,
        photographs=[camera.photographs[index] for index in indices],
        camera_from_board=camera.camera_from_board[indices],
        residuals=camera.residuals[indices],
        outliers=camera.outliers[indices],
    )


def main() -> None:
    """Measures all sets."""
    folder = Path(sys.argv[1])
    found = [measure(folder / name, prefix, board) for name, prefix, board in _SETS]
    # Names of the photographs taken together differ in left and right.
    for name in ("fisheye by opencv", "opencv8 by mrcal"):
        cameras = [solutions[name] for solutions in found[:2]]
        for camera, side in zip(cameras, ("left", "right"), strict=True):
            for photograph in camera.photographs:
                photograph.frame = photograph.path.stem.removeprefix(side)
        measure_rig(cameras, _SETS[0][2])


if __name__ == "__main__":
    main()
