"""Chessboards seen through a known lens: corners with noise, or whole pictures; truth for tests."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

import gsut
from calib.boards.board import Board, Photograph
from calib.camera.projection import PIXEL_SHIFT
from calib.camera.rigid import matrix_from_rodrigues, transform_points

_TRIES = 200  # for a pose that shows the whole board
_MARGIN_PX = 8.0  # of the board from the image's edge
_TILT = np.radians(50.0)  # largest, of the board to the line of sight


def random_poses(
    camera: gsut.Camera,
    board: Board,
    count: int,
    widest_degrees: float,
    generator: np.random.Generator,
) -> np.ndarray:
    """(count, 6) poses camera_from_board: everywhere in the field, the whole board in the image.

    Args:
        camera: the lens. board: the chessboard. count: how many.
        widest_degrees: of the board's centre from the axis. generator: the only randomness.

    Raises:
        ValueError: the board does not fit into the image at any tried pose.
    """
    size = np.hypot(board.columns - 1, board.rows - 1) * board.spacing
    poses = []
    for _ in range(count):
        for _ in range(_TRIES):
            angle = np.radians(widest_degrees) * np.sqrt(generator.uniform())
            azimuth = generator.uniform(0, 2 * np.pi)
            sight = np.array(
                [
                    np.sin(angle) * np.cos(azimuth),
                    np.sin(angle) * np.sin(azimuth),
                    np.cos(angle),
                ]
            )
            axis = np.cross([0.0, 0.0, 1.0], sight)
            axis = axis / max(np.linalg.norm(axis), 1e-12) * angle
            tilt = np.append(generator.uniform(-_TILT, _TILT, 2), generator.uniform(-np.pi, np.pi))
            rotation = matrix_from_rodrigues(axis) @ matrix_from_rodrigues(tilt)
            centre = sight * size * generator.uniform(0.8, 1.6)
            rotation_vector = cv2.Rodrigues(rotation)[0].ravel()
            middle = rotation @ board.locate_corners().mean(axis=0)
            pose = np.concatenate([rotation_vector, centre - middle])
            if _fits(camera, transform_points(pose, board.locate_corners())):
                poses.append(pose)
                break
        else:
            raise ValueError("the board does not fit into the image: make it smaller")
    return np.stack(poses)


def _fits(camera: gsut.Camera, points: np.ndarray) -> bool:
    pixels, valid = camera.project(points)
    limit = np.array([camera.width, camera.height]) - _MARGIN_PX
    return bool(valid.all() and np.all(pixels > _MARGIN_PX) and np.all(pixels < limit))


def photographs(
    camera: gsut.Camera,
    board: Board,
    poses: np.ndarray,
    noise_px: float,
    generator: np.random.Generator,
    warp: Sequence[float] | None = None,
) -> list[Photograph]:
    """Corners of the board at (V, 6) poses, with Gaussian noise in pixels; no pictures.

    The board may be bent by `warp`, see `Board.points`.
    """
    result = []
    for index, pose in enumerate(poses):
        pixels, _ = camera.project(transform_points(pose, board.locate_corners(warp)))
        corners = pixels - PIXEL_SHIFT + noise_px * generator.standard_normal(pixels.shape)
        photograph = Photograph(Path(f"synthetic{index:03d}.png"), "camera", str(index))
        photograph.width, photograph.height = camera.width, camera.height
        photograph.corners = corners
        result.append(photograph)
    return result


def draw(camera: gsut.Camera, board: Board, pose: np.ndarray, samples: int = 3) -> np.ndarray:
    """(H, W) uint8: the board through the lens, `samples` x `samples` rays a pixel, grey around."""
    height, width = camera.height, camera.width
    fine = (np.arange(samples) + 0.5) / samples
    x, y = np.meshgrid(
        (np.arange(width)[:, None] + fine).ravel(), (np.arange(height)[:, None] + fine).ravel()
    )
    rays, valid = camera.unproject(np.stack([x, y], axis=-1).reshape(-1, 2))
    rotation, origin = matrix_from_rodrigues(pose[:3]), np.asarray(pose[3:])
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = (rotation[:, 2] @ origin) / (rays @ rotation[:, 2])
        on_board = ((rays * distance[:, None] - origin) @ rotation)[:, :2] / board.spacing
    hit = valid & (distance > 0)
    square = np.floor(on_board)
    inside = hit & np.all(on_board > -1, axis=1)
    inside &= (on_board[:, 0] < board.columns) & (on_board[:, 1] < board.rows)
    paper = hit & np.all(on_board > -2, axis=1)
    paper &= (on_board[:, 0] < board.columns + 1) & (on_board[:, 1] < board.rows + 1)
    grey = np.full(len(rays), 110.0)
    grey[paper] = 235.0
    with np.errstate(invalid="ignore"):
        grey[inside & (square.sum(axis=1) % 2 == 0)] = 25.0
    grid = grey.reshape(height, samples, width, samples)
    return np.rint(grid.mean(axis=(1, 3))).astype(np.uint8)
