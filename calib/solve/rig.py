"""Solves for the relative poses of a rig's cameras, and which way up each saw the board."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.boards import Board, Photograph
from calib.camera import (
    CameraSolution,
    Observation,
    compose,
    invert,
    make_projector,
    matrix_from_rodrigues,
    measure_rotation_angle,
)
from calib.errors import SolveError
from calib.solve.pose_fit import compute_residuals, fit_poses

_SAME_ROTATION = np.radians(10.0)  # between two frames of one rig: board poses are more accurate
SHAKY = 1.5  # times the cameras' own residuals above which the frames were not simultaneous


def unify_turns(cameras: Sequence[CameraSolution], board: Board) -> list[Photograph]:
    """Finds photographs whose corners must be turned by 180 degrees to agree with the first camera.

    A board whose columns + rows is even looks the same upside down: two cameras may have numbered
    its corners from opposite ends. The rig's rotation decides: each frame allows two, and the one
    on which most frames agree is right.

    Args:
        cameras: solved separately. board: the chessboard.
    """
    if (board.columns + board.rows) % 2 == 1:
        return []
    half_turn = np.diag([-1.0, -1.0, 1.0])
    to_turn: list[Photograph] = []
    first = cameras[0]
    for camera in cameras[1:]:
        pairs = match_frames(first, camera)
        rotations = [
            [
                matrix_from_rodrigues(camera.camera_from_board[j, :3])
                @ turn
                @ matrix_from_rodrigues(first.camera_from_board[i, :3]).T
                for turn in (np.eye(3), half_turn)
            ]
            for i, j in pairs
        ]
        if not rotations:
            continue
        candidates = [rotation for pair in rotations for rotation in pair]
        votes = [
            sum(
                min(measure_rotation_angle(c, r) for r in pair) < _SAME_ROTATION
                for pair in rotations
            )
            for c in candidates
        ]
        agreed = candidates[int(np.argmax(votes))]
        for (_, j), pair in zip(pairs, rotations, strict=True):
            if measure_rotation_angle(agreed, pair[1]) < measure_rotation_angle(agreed, pair[0]):
                to_turn.append(camera.photographs[j])
    return to_turn


def match_frames(first: CameraSolution, second: CameraSolution) -> list[tuple[int, int]]:
    """Lists index pairs of the photographs that two cameras took together."""
    frames = {photograph.frame: i for i, photograph in enumerate(first.photographs)}
    return [
        (frames[photograph.frame], j)
        for j, photograph in enumerate(second.photographs)
        if photograph.frame in frames
    ]


def solve_rig(cameras: Sequence[CameraSolution], board: Board) -> tuple[float, list[str]]:
    """Sets the pose of every camera relative to the first, with the lenses held.

    The lenses are those of the separate solves: photographs that were not quite simultaneous, or a
    board that moved, would otherwise bend them.

    Args:
        cameras: solved separately; their camera_from_reference is set. board: the chessboard.

    Returns:
        RMS (2-D, px) over the shared frames with one pose of the rig, and notes.

    Raises:
        SolveError: a camera shares no frame with the others.
    """
    poses = _chain_poses(cameras)
    reference_from_board: dict[str, np.ndarray] = {}
    for camera, pose in zip(cameras, poses, strict=True):
        for photograph, board_pose in zip(
            camera.photographs, camera.camera_from_board, strict=True
        ):
            reference_from_board.setdefault(photograph.frame, compose(invert(pose), board_pose))
    frames = list(reference_from_board)
    observations = [
        Observation(index, frames.index(photograph.frame), photograph.corners[good], points)
        for index, camera in enumerate(cameras)
        for photograph, good in zip(camera.photographs, _find_usable(camera, board), strict=True)
        for points in [board.locate_corners(camera.warp)[good]]
    ]
    starts = np.stack([reference_from_board[frame] for frame in frames])
    found, boards = fit_poses(cameras, observations, np.stack(poses), starts)
    for camera, pose in zip(cameras, found, strict=True):
        camera.camera_from_reference = pose
    seen_by = np.bincount([o.board for o in observations], minlength=len(frames))
    left = compute_residuals(cameras, observations, found, boards)
    shared = [r for r, o in zip(left, observations, strict=True) if seen_by[o.board] > 1]
    rms = float(np.sqrt(np.mean(np.sum(np.concatenate(shared) ** 2, axis=1))))
    alone = compute_rms(cameras)
    return rms, [describe_shaky_rig(rms, alone)] if rms > SHAKY * alone else []


def _find_usable(camera: CameraSolution, board: Board) -> np.ndarray:
    """Marks corners (V, corners) that are no outliers and lie in the lens' domain."""
    points = camera.locate_corners(board)
    pixels = make_projector(camera)(camera.params, points.reshape(-1, 3))[0]
    return ~camera.outliers & np.isfinite(pixels).all(axis=1).reshape(points.shape[:2])


def compute_rms(cameras: Sequence[CameraSolution]) -> float:
    """Computes the root mean square length in pixels of all cameras' inlier residuals."""
    squares = [np.sum(c.residuals[~c.outliers] ** 2, axis=1) for c in cameras]
    return float(np.sqrt(np.mean(np.concatenate(squares))))


def describe_shaky_rig(rms: float, alone: float) -> str:
    """Explains that one pose of the rig does not fit all frames; RMS in pixels."""
    return (
        f"with one pose of the rig the residuals are {rms:.2f} px, each camera alone has "
        f"{alone:.2f}: the images of one frame were not taken together, or the rig bends; "
        "the lenses were therefore solved camera by camera"
    )


def _chain_poses(cameras: Sequence[CameraSolution]) -> list[np.ndarray]:
    """Places each camera relative to the first, through cameras already placed.

    Of the poses that the shared frames give, the one with the least total distance is taken.
    """
    poses: dict[int, np.ndarray] = {0: np.zeros(6)}
    while len(poses) < len(cameras):
        links = [
            (len(match_frames(cameras[i], cameras[j])), i, j)
            for i in poses
            for j in range(len(cameras))
            if j not in poses
        ]
        count, placed, new = max(links)
        if count == 0:
            raise SolveError(
                f"the camera {cameras[new].name} has no frame in which another camera saw the "
                "board too: their pose to each other cannot be known"
            )
        relative = [
            compose(cameras[new].camera_from_board[j], invert(cameras[placed].camera_from_board[i]))
            for i, j in match_frames(cameras[placed], cameras[new])
        ]
        distance = [sum(np.linalg.norm(a - b) for b in relative) for a in relative]
        poses[new] = compose(relative[int(np.argmin(distance))], poses[placed])
    return [poses[index] for index in range(len(cameras))]
