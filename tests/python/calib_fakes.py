"""What the tests of calib/ share: its place on the path, a known lens, boards seen through it."""

import sys
from pathlib import Path

import cv2
import numpy as np

import gsut

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from calib.boards.board import Board  # noqa: E402
from tests.synthetic_boards import draw, photographs, random_poses  # noqa: E402

BOARD = Board(7, 5, 0.03)
FISHEYE = gsut.Camera(
    "kannala_brandt", [130.0, 131.0, 212.0, 159.0, 0.02, -0.01, 0.004, -0.001], 420, 320
)
WIDEST_DEGREES = 50.0  # of the boards' centres


def corner_photographs(count, noise_px, generator, camera=FISHEYE, board=BOARD):
    """Photographs of corners only, without pictures, and the true poses of their boards."""
    poses = random_poses(camera, board, count, WIDEST_DEGREES, generator)
    return photographs(camera, board, poses, noise_px, generator), poses


def write_pictures(folder, count, generator, camera=FISHEYE, board=BOARD, prefix="board"):
    """Draws boards into PNG files; returns their paths and the true poses."""
    poses = random_poses(camera, board, count, WIDEST_DEGREES, generator)
    paths = []
    for index, pose in enumerate(poses):
        paths.append(folder / f"{prefix}{index}.png")
        cv2.imwrite(str(paths[-1]), draw(camera, board, pose, samples=2))
    return paths, np.asarray(poses)
