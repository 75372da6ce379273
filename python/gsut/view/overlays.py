"""Draws over a frame through its own lens: cameras, points, marks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from gsut.data import Scene
from gsut.data.poses import invert_pose
from gsut.lens import Camera

# Pieces of each line: straight in space is bent in the image.
_PIECES = 12
# Longest piece that is drawn, x the image's width: a longer one crosses the edge or a seam.
_LONGEST_JUMP = 0.25
# Length of the rays of a camera's frustum, x scene extent.
_FRUSTUM = 0.06
# Colour of training views' cameras.
_TRAINING = (96, 165, 250)
# Colour of held-out views' cameras.
_HELD_OUT = (251, 146, 60)
# Colour of marks.
_MARK = (52, 211, 153)


def draw_lines(
    image: np.ndarray,
    camera: Camera,
    pose: np.ndarray,
    starts: np.ndarray,
    ends: np.ndarray,
    colors: Sequence[tuple[int, int, int]],
) -> None:
    """Draws straight lines of the world as the lens sees them.

    Args:
        image: (H, W, 3) uint8, drawn upon.
        camera: of the image's size.
        pose: (4, 4) camera_from_world.
        starts, ends: (N, 3).
        colors: N of them.
    """
    import cv2

    if not len(starts):
        return
    t = np.linspace(0.0, 1.0, _PIECES + 1)[:, None]
    points = starts[:, None] * (1 - t) + ends[:, None] * t
    pixels, valid = camera.project(points.reshape(-1, 3) @ pose[:3, :3].T + pose[:3, 3])
    pixels = pixels.reshape(len(starts), -1, 2)
    valid = valid.reshape(len(starts), -1)
    with np.errstate(invalid="ignore"):
        step = np.linalg.norm(np.diff(pixels, axis=1), axis=2)
        near = np.all(np.abs(pixels) < 16 * max(image.shape), axis=2) & valid
    joined = near[:, 1:] & near[:, :-1] & (step < _LONGEST_JUMP * image.shape[1])
    fixed = np.rint(np.where(near[..., None], pixels, 0) * 16 - 8).astype(np.int32)
    for row, color in enumerate(colors):
        pieces = [fixed[row, k : k + 2] for k in np.flatnonzero(joined[row])]
        if pieces:
            cv2.polylines(image, pieces, False, color, 1, cv2.LINE_AA, 4)


def draw_points(
    image: np.ndarray, camera: Camera, pose: np.ndarray, points: np.ndarray, colors: np.ndarray
) -> None:
    """Draws points as dots of 2 x 2 pixels, near ones over far ones."""
    if not len(points):
        return
    height, width = image.shape[:2]
    in_camera = points @ pose[:3, :3].T + pose[:3, 3]
    pixels, valid = camera.project(in_camera)
    with np.errstate(invalid="ignore"):
        inside = valid & np.all((pixels >= 0) & (pixels < [width - 1, height - 1]), axis=1)
    order = np.flatnonzero(inside)
    order = order[np.argsort(-np.sum(in_camera[order] ** 2, axis=1))]
    column, row = pixels[order].astype(np.int64).T
    for down in (0, 1):
        for right in (0, 1):
            image[row + down, column + right] = colors[order]


def draw_cameras(
    image: np.ndarray, camera: Camera, pose: np.ndarray, scene: Scene, chosen: int | None
) -> None:
    """Draws each photograph's camera as rays through the border of its image."""
    starts, ends, colors = [], [], []
    held_out = set(scene.test_indices)
    for index, view in enumerate(scene.views):
        if index == chosen:
            continue  # the eye itself
        world = invert_pose(view.camera_from_world)
        border = make_frustum(scene.camera(index)) * (_FRUSTUM * scene.extent)
        corners = border @ world[:3, :3].T + world[:3, 3]
        color = _HELD_OUT if index in held_out else _TRAINING
        starts += [*corners, *[world[:3, 3]] * (len(corners) // 2)]
        ends += [*np.roll(corners, -1, axis=0), *corners[::2]]
        colors += [color] * (len(corners) + len(corners) // 2)
    draw_lines(image, camera, pose, np.array(starts), np.array(ends), colors)


def make_frustum(camera: Camera) -> np.ndarray:
    """Returns (8, 3) rays around the border of an image, moved inward to where the lens sees."""
    width, height = camera.width, camera.height
    middle = np.array([width, height]) / 2
    corners = np.array(
        [[0, 0], [.5, 0], [1, 0], [1, .5], [1, 1], [.5, 1], [0, 1], [0, .5]]
    ) * [width, height]  # fmt: skip
    rays = np.tile([0.0, 0.0, 1.0], (8, 1))
    missing = np.ones(8, bool)
    for inward in np.linspace(0.0, 0.9, 10):
        found, valid = camera.unproject(corners + inward * (middle - corners))
        use = missing & valid
        rays[use] = found[use]
        missing &= ~valid
    return rays


def draw_marks(image: np.ndarray, camera: Camera, pose: np.ndarray, marks: np.ndarray) -> None:
    """Draws measured points and the line between each pair."""
    import cv2

    pairs = marks[: len(marks) // 2 * 2].reshape(-1, 2, 3)
    draw_lines(image, camera, pose, pairs[:, 0], pairs[:, 1], [_MARK] * len(pairs))
    pixels, valid = camera.project(marks @ pose[:3, :3].T + pose[:3, 3])
    for pixel in pixels[valid]:
        if np.all(np.abs(pixel) < 1e4):
            x, y = (round(value) for value in pixel)
            cv2.circle(image, (x, y), 5, (0, 0, 0), 3, cv2.LINE_AA)
            cv2.circle(image, (x, y), 5, _MARK, 2, cv2.LINE_AA)


def mark_without_ray(image: np.ndarray, valid: Any) -> None:
    """Marks the pixels that have no ray by stripes."""
    rows, columns = np.nonzero(~np.asarray(valid, bool))
    stripe = ((rows + columns) // 6) % 2
    image[rows, columns] = np.where(stripe[:, None], (70, 40, 48), (40, 24, 30)).astype(np.uint8)
