"""Solves all cameras of a rig at once with mrcal-calibrate-cameras, from their solves alone."""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calib.board import Board
from calib.corner_files import write_vnl
from calib.lens import splined_configuration
from calib.mrcal_process import ask, calibrate_cameras
from calib.rig import SHAKY, rms_of_all, shaky_note, solve_rig
from calib.rigid import compose, inverse
from calib.solution import CameraSolution
from calib.solve_mrcal import solve_camera


def solve_rig_together(
    cameras: Sequence[CameraSolution], board: Board
) -> tuple[list[CameraSolution], float, list[str]]:
    """All cameras and boards in one solve; where the frames were not simultaneous, which would
    bend the lenses, the poses of such a solve with the lenses of each camera alone.

    Args:
        cameras: solved by mrcal alone. board: the chessboard.

    Returns:
        The cameras, the RMS (2-D, px) with one pose of the rig, and notes.

    Raises:
        SolveError: a camera shares no frame with the others, or mrcal failed.
    """
    cameras = _of_one_kind(cameras, board)
    solve_rig(cameras, board)
    together = solve_together(cameras, board)
    rms, alone = rms_of_all(together), rms_of_all(cameras)
    if rms <= SHAKY * alone:
        return together, rms, []
    held = solve_together(cameras, board, hold_lenses=True)
    for camera, placed in zip(cameras, held, strict=True):
        camera.camera_from_reference = placed.camera_from_reference
    rms = rms_of_all(held)
    return list(cameras), rms, [shaky_note(rms, alone)]


def _of_one_kind(cameras: Sequence[CameraSolution], board: Board) -> list[CameraSolution]:
    """The cameras; those with splines of different knots solved again with the widest's."""
    if len({camera.model for camera in cameras}) == 1:
        return list(cameras)
    widest = max(cameras, key=lambda camera: splined_configuration(camera.model)[::-1]).model
    again = []
    for camera in cameras:
        solved = solve_camera(camera.photographs, board, camera.lens, model=widest)
        again.append(dataclasses.replace(solved, name=camera.name))
    return again


def solve_together(
    cameras: Sequence[CameraSolution], board: Board, hold_lenses: bool = False
) -> list[CameraSolution]:
    """One solve for the poses of the rig and of all boards, and for the lenses.

    Photographs of one frame share the board's pose; mrcal throws outliers out by its own rule.

    Args:
        cameras: solved by mrcal alone with one model, and placed (`rig.solve_rig`).
        board: the chessboard. hold_lenses: keep the lenses and the board's shape as they are.

    Returns:
        The cameras with what the joint solve found; model_text holds all of it.

    Raises:
        SolveError: mrcal failed.
    """
    frames = sorted({p.frame for camera in cameras for p in camera.photographs})
    names = [
        [f"camera{index}-{frames.index(p.frame):05d}.jpg" for p in camera.photographs]
        for index, camera in enumerate(cameras)
    ]
    with tempfile.TemporaryDirectory(prefix="gsut-calib-") as name:
        folder = Path(name)
        every = [photograph for camera in cameras for photograph in camera.photographs]
        write_vnl(folder / "corners.vnl", every, [name for group in names for name in group])
        arguments = {
            "--corners-cache": "corners.vnl",
            "--lensmodel": cameras[0].model,
            "--focal": ",".join(f"{float(np.mean(camera.params[:2])):.3f}" for camera in cameras),
            "--object-spacing": repr(board.spacing),
            "--object-width-n": str(board.columns),
            "--object-height-n": str(board.rows),
            "--outdir": ".",
        }
        flat = [word for pair in arguments.items() for word in pair]
        size = ["--imagersize", str(cameras[0].width), str(cameras[0].height)]
        globs = [f"camera{index}-*.jpg" for index in range(len(cameras))]
        calibrate_cameras([*flat, *size, *globs], folder)
        text = (folder / "camera-0.cameramodel").read_text(encoding="utf-8")
    # mrcal 2.2 refuses --seed without --focal and with it: its solve is taken up again by its
    # Python module, from the lenses and poses that the cameras' own solves gave.
    boards: dict[str, list[float]] = {}
    for camera in cameras:
        back = inverse(camera.camera_from_reference)
        for photograph, pose in zip(camera.photographs, camera.camera_from_board, strict=True):
            boards.setdefault(photograph.frame, compose(back, pose).tolist())
    question = {
        "do": "solve_together",
        "models": [text],
        "params": [camera.params.tolist() for camera in cameras],
        "sizes": [[camera.width, camera.height] for camera in cameras],
        "poses": [camera.camera_from_reference.tolist() for camera in cameras],
        "boards": [boards[frame] for frame in frames],
        "warp": np.mean([camera.warp for camera in cameras], axis=0).tolist(),
        "hold_lenses": hold_lenses,
    }
    found = ask(question)["cameras"]
    return [
        _with(camera, group, values)
        for camera, group, values in zip(cameras, names, found, strict=True)
    ]


def _with(camera: CameraSolution, names: Sequence[str], values: dict) -> CameraSolution:
    """The camera with its part of a joint solve; mrcal's order of the images is its own."""
    order = [values["images"].index(name) for name in names]
    pose = np.array(values["camera_from_reference"])
    boards = np.array(values["reference_from_board"])[order]
    return dataclasses.replace(
        camera,
        params=np.array(values["params"]),
        camera_from_reference=pose,
        camera_from_board=np.stack([compose(pose, board) for board in boards]),
        residuals=np.array(values["residuals"])[order],
        outliers=np.array(values["outliers"], bool)[order],
        model_text=values["text"],
        warp=values["warp"],
    )
