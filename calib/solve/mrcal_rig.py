"""Solves all cameras of a rig at once with mrcal-calibrate-cameras, from their separate solves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.boards import Board
from calib.camera import CameraSolution, compose, invert, parse_splined_name
from calib.solve.mrcal_process import calibrate_cameras
from calib.solve.mrcal_solver import solve_again, solve_by_mrcal, update_camera
from calib.solve.rig import SHAKY, compute_rms, describe_shaky_rig, solve_rig


def solve_rig_together(
    cameras: Sequence[CameraSolution], board: Board
) -> tuple[list[CameraSolution], float, list[str]]:
    """Solves for all lenses and poses in one solve.

    Frames that were not simultaneous would bend the lenses: then the lenses of the separate solves
    are kept, and only the poses come from the joint solve.

    Args:
        cameras: solved separately by mrcal. board: the chessboard.

    Returns:
        The cameras, the RMS (2-D, px) with one pose of the rig, and notes.

    Raises:
        SolveError: a camera shares no frame with the others, or mrcal failed.
    """
    cameras = _unify_models(cameras, board)
    solve_rig(cameras, board)
    together = solve_together(cameras, board)
    rms, alone = compute_rms(together), compute_rms(cameras)
    if rms <= SHAKY * alone:
        return together, rms, []
    held = solve_together(cameras, board, hold_lenses=True)
    for camera, placed in zip(cameras, held, strict=True):
        camera.camera_from_reference = placed.camera_from_reference
    rms = compute_rms(held)
    return list(cameras), rms, [describe_shaky_rig(rms, alone)]


def _unify_models(cameras: Sequence[CameraSolution], board: Board) -> list[CameraSolution]:
    """Solves cameras again whose splines have other knots than those of the widest lens."""
    if len({camera.model for camera in cameras}) == 1:
        return list(cameras)
    widest = max(cameras, key=lambda camera: parse_splined_name(camera.model)[::-1]).model
    return [solve_by_mrcal(c.photographs, board, c.lens, model=widest) for c in cameras]


def solve_together(
    cameras: Sequence[CameraSolution], board: Board, hold_lenses: bool = False
) -> list[CameraSolution]:
    """Solves at once for the poses of the rig and of all boards, and for the lenses.

    Photographs of one frame share the board's pose; mrcal's own rule rejects outliers.

    Args:
        cameras: solved separately by mrcal with one model, and placed by `solve_rig`.
        board: the chessboard. hold_lenses: keep the lenses and the board's shape as they are.

    Returns:
        The cameras as the joint solve found them; model_text holds all of it.

    Raises:
        SolveError: mrcal failed.
    """
    frames = sorted({p.frame for camera in cameras for p in camera.photographs})
    names = [
        [f"camera{index}-{frames.index(p.frame):05d}.jpg" for p in camera.photographs]
        for index, camera in enumerate(cameras)
    ]
    groups = [camera.photographs for camera in cameras]
    focals = [float(np.mean(camera.params[:2])) for camera in cameras]
    text = calibrate_cameras(cameras[0].model, groups, names, focals, board)
    boards: dict[str, np.ndarray] = {}
    for camera in cameras:
        reference_from_camera = invert(camera.camera_from_reference)
        for photograph, pose in zip(camera.photographs, camera.camera_from_board, strict=True):
            boards.setdefault(photograph.frame, compose(reference_from_camera, pose))
    warp = np.mean([camera.warp for camera in cameras], axis=0)
    in_order = np.stack([boards[frame] for frame in frames])
    found = solve_again(text, cameras, in_order, warp, hold_lenses)
    return [update_camera(*each) for each in zip(cameras, names, found, strict=True)]
