"""Oracles of calibration: coverage of the stated uncertainty, and OpenCV's stereo calibration."""

from __future__ import annotations

import cv2
import numpy as np

import gsut
from calib.boards import Board
from calib.camera import (
    PIXEL_SHIFT,
    CameraSolution,
    matrix_from_rodrigues,
    rodrigues_from_matrix,
    to_gsut_camera,
    unproject_pixels,
)
from calib.solve import solve_by_opencv
from calib.trust.uncertainty import estimate_parameter_covariance, propagate_covariance
from synthetic_boards import photographs, random_poses

NOISE_PX = 0.2  # put on every corner
_BOARD = Board(8, 6, 0.03)
_BOARDS = 20
_FISHEYE = (200.0, 201.0, 322.0, 238.0, 0.02, -0.01, 0.004, -0.001)  # fx fy cx cy k1 .. k4
_WIDTH = 640  # pixels
_HEIGHT = 480
_WIDEST_DEGREES = 65.0  # of the boards' centres from the axis


def measure_coverage(solves: int, seed: int = 1) -> tuple[np.ndarray, float, float]:
    """Solves a known fisheye many times from random boards.

    Args:
        solves: how many. seed: of poses and noise.

    Returns:
        Part of solves in which each parameter (K,) lies within 2 sigma of the truth; the same for
        the coordinates of the pixels of distant directions; mean of noise found over noise put in.
    """
    generator = np.random.default_rng(seed)
    camera = gsut.Camera("kannala_brandt", _FISHEYE, _WIDTH, _HEIGHT)
    columns, rows = np.linspace(120, 520, 5), np.linspace(90, 390, 4)
    pixels = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    within, projected, ratio = [], [], []
    for _ in range(solves):
        poses = random_poses(camera, _BOARD, _BOARDS, _WIDEST_DEGREES, generator)
        seen = photographs(camera, _BOARD, poses, NOISE_PX, generator)
        solved = solve_by_opencv(seen, _BOARD, "fisheye")
        sigma, cov, layout, noise = estimate_parameter_covariance(solved, _BOARD)
        found = solved.params.copy()
        found[2:4] += PIXEL_SHIFT
        within.append(np.abs(found - _FISHEYE) <= 2 * sigma)
        ratio.append(noise / NOISE_PX)
        spread = propagate_covariance(
            solved, unproject_pixels(solved, pixels - PIXEL_SHIFT), cov, layout.boards
        )
        deviation = np.sqrt(np.einsum("nii->ni", spread))
        error = _project_again(camera, solved, poses, pixels) - pixels
        projected.append((np.abs(error) <= 2 * deviation).ravel())
    inside = float(np.mean(np.concatenate(projected)))
    return np.mean(within, axis=0), inside, float(np.mean(ratio))


def _project_again(
    camera: gsut.Camera, solved: CameraSolution, poses: np.ndarray, pixels: np.ndarray
) -> np.ndarray:
    """Projects true directions of pixels, which stay fixed to the boards, by the solved lens."""
    true_rays, valid = camera.unproject(pixels)
    assert valid.all()
    turns = [
        rodrigues_from_matrix(matrix_from_rodrigues(found[:3]) @ matrix_from_rodrigues(true[:3]).T)
        for found, true in zip(solved.camera_from_board, poses, strict=True)
    ]
    turned = true_rays @ matrix_from_rodrigues(np.mean(turns, axis=0)).T
    again, _ = to_gsut_camera(solved).project(turned)
    return again


def calibrate_stereo(first: CameraSolution, second: CameraSolution, board: Board) -> np.ndarray:
    """Finds (6,) second camera from the first by OpenCV, the lenses held.

    All boards are whole, and bent as the first camera's solve found.
    """
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
        flags=getattr(cv2.fisheye, "CALIB_FIX_INTRINSIC", cv2.CALIB_FIX_INTRINSIC)
        if fisheye
        else flags,
        criteria=(cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 300, 1e-12),
    )
    return np.concatenate([cv2.Rodrigues(answer[5])[0].ravel(), answer[6].ravel()])
