"""Measures the solves of the real board sets: residuals, the rig's pose, agreement of two lenses.

    PYTHONPATH=python:. python calib/measure_boards.py BOARDS

BOARDS holds fisheye_stereo/ and ocam_fisheye1/ (see README.md).
"""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

import cv2
import numpy as np

from calib import solve_mrcal, solve_opencv
from calib.board import Board, assign_cameras
from calib.corners import find_boards
from calib.halves import AGREEMENT_DEGREES, agreement_angle
from calib.rig import solve_rig
from calib.rigid import compose, inverse
from calib.solution import CameraSolution
from calib.trust import judge
from calib.uncertainty import uncertainty_map

_SETS = (
    ("fisheye_stereo", "left", Board(9, 6, 0.02423)),
    ("fisheye_stereo", "right", Board(9, 6, 0.02423)),
    ("ocam_fisheye1", "Fisheye", Board(6, 8, 0.0325)),
)
_SOLVES = (
    (solve_opencv, "fisheye"),
    (solve_opencv, "opencv8"),
    (solve_mrcal, "opencv8"),
    (solve_mrcal, "splined"),
)


def measure(folder: Path, prefix: str, board: Board) -> dict[str, CameraSolution]:
    """Solves one camera with every lens and prints a line each."""
    photographs = assign_cameras(sorted(folder.glob(f"{prefix}*.jpg")), [])
    find_boards(photographs, board, progress=False)
    found = [photograph for photograph in photographs if photograph.corners is not None]
    print(f"{folder.name} {prefix}: {len(found)} boards in {len(photographs)} photographs")
    solutions = {}
    for solver, lens in _SOLVES:
        camera = solver.solve_camera(found, board, lens)
        trust = judge(camera, board, uncertainty_map(camera, board))
        solutions[f"{lens} by {camera.solver}"] = camera
        degrees = np.degrees([trust.valid_angle, trust.reach, trust.domain])
        print(
            f"  {lens:8} by {camera.solver:6}: RMS {camera.rms_2d_px:.4f} px 2-D, "
            f"{camera.rms_axis_px:.4f} an axis, {camera.outliers.sum():2d} outliers; trusted to "
            f"{degrees[0]:5.1f}, boards to {degrees[1]:5.1f}, one-to-one to {degrees[2]:5.1f} "
            f"degrees{'; REFUSED' if trust.refusal else ''}"
        )
    names = list(solutions)
    for index, name in enumerate(names):
        for other in names[index + 1 :]:
            a, b = solutions[name], solutions[other]
            limit = min(judge(c, board, np.full((1, 1), np.nan)).valid_angle for c in (a, b))
            angle = np.degrees(agreement_angle(a, b, limit))
            print(
                f"    {name} and {other} agree within {AGREEMENT_DEGREES} degree to "
                f"{angle:.0f} of {np.degrees(limit):.0f} degrees"
            )
    return solutions


def measure_rig(left: CameraSolution, right: CameraSolution, board: Board) -> None:
    """Our pose of the rig against cv2.fisheye.stereoCalibrate with the same lenses."""
    solve_rig([left, right], board)
    everything = right.camera_from_reference
    # OpenCV takes whole boards only: those without an outlier in either image.
    whole = [
        index
        for index in range(len(left.photographs))
        if not (left.outliers[index].any() or right.outliers[index].any())
    ]
    left, right = (_only(camera, whole) for camera in (left, right))
    solve_rig([left, right], board)
    ours = right.camera_from_reference
    lenses = []
    for camera in (left, right):
        fx, fy, cx, cy = camera.params[:4]
        matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
        lenses += [matrix, camera.params[4:].copy()]
    answer = cv2.fisheye.stereoCalibrate(
        [board.points()[None] for _ in whole],
        [photograph.corners[None] for photograph in left.photographs],
        [photograph.corners[None] for photograph in right.photographs],
        *lenses,
        (left.width, left.height),
        flags=cv2.fisheye.CALIB_FIX_INTRINSIC,
        criteria=(cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 200, 1e-10),
    )
    theirs = np.concatenate([cv2.Rodrigues(answer[5])[0].ravel(), answer[6].ravel()])
    for name, pose in (("the same boards", ours), ("all boards", everything)):
        error = compose(pose, inverse(theirs))
        print(
            f"rig, {name}: {np.linalg.norm(pose[3:]) * 1000:.2f} mm apart; from "
            f"cv2.fisheye.stereoCalibrate with the same lenses and {len(whole)} whole boards: "
            f"{np.degrees(np.linalg.norm(error[:3])):.4f} degree, "
            f"{np.linalg.norm(pose[3:] - theirs[3:]) * 1000:.4f} mm"
        )


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
    left, right = (solutions["fisheye by opencv"] for solutions in found[:2])
    # Names of the photographs taken together differ in left and right.
    for camera, name in ((left, "left"), (right, "right")):
        for photograph in camera.photographs:
            photograph.moment = photograph.path.stem.removeprefix(name)
    measure_rig(left, right, _SETS[0][2])


if __name__ == "__main__":
    main()
