"""Colours of points from the photographs that see them, such as of a LiDAR's cloud."""

from __future__ import annotations

import numpy as np

from gsut.bounds import name_wrong_kinds
from gsut.data.points.ply import NO_COLOR
from gsut.data.scene import Scene
from gsut.run import Progress

_MOST_VIEWS = 150  # evenly chosen: more change the colours little
_SLOTS = 7  # nearest photographs of a point: their median is its colour
_PER_CELL = 4  # points that a cell of a view holds on average: the nearest of them is seen
_BEHIND = 1.05  # times the nearest point's distance, up to which others of its cell are seen, too
_WIDEST_CELL = 48  # cells along the longer side, at least
UNCOLORED = "the points have no colours: training takes theirs from the photographs"


def has_colors(scene: Scene) -> bool:
    """Returns whether the scene's points differ in colour; without colours all are read as grey."""
    return len(scene.points) > 0 and bool(np.ptp(scene.point_colors) > 0)


@name_wrong_kinds
def color_points(
    scene: Scene, points: np.ndarray, *, progress: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Takes the median colour of the pixels at which photographs see points.

    A point counts as seen where no other point of its surroundings is nearer to the camera; of all
    photographs that see it, the nearest are asked.

    Args:
        scene: photographs, poses and lenses.
        points: (N, 3) in the scene's coordinates.
        progress: show a bar.

    Returns:
        (N, 3) uint8, grey where no photograph sees a point, and (N,) how many were asked.
    """
    points = np.asarray(points, np.float64).reshape(-1, 3)
    distances = np.full((_SLOTS, len(points)), np.inf, np.float32)
    colors = np.zeros((_SLOTS, len(points), 3), np.uint8)
    count = min(len(scene), _MOST_VIEWS)
    chosen = np.unique(np.linspace(0, len(scene) - 1, count).round().astype(int)).tolist()
    for index in Progress(progress).iterate("colours", chosen):
        rows, x, y, away = _find_seen_points(scene, index, points)
        slot = distances[:, rows].argmax(axis=0)
        nearer = away < distances[slot, rows]
        rows, slot = rows[nearer], slot[nearer]
        distances[slot, rows] = away[nearer]
        colors[slot, rows] = scene.image(index)[y[nearer], x[nearer]]
    views = np.isfinite(distances).sum(axis=0)
    # Empty slots go last: the median of the others is then in their middle.
    order = np.where(np.isfinite(distances)[..., None], colors.astype(np.int16), 256)
    order.sort(axis=0)
    every = np.arange(len(points))
    low, high = np.maximum(views - 1, 0) // 2, views // 2
    middle = (order[low, every] + order[high, every] + 1) // 2
    return np.where(views[:, None] > 0, middle, NO_COLOR).astype(np.uint8), views


def _find_seen_points(
    scene: Scene, index: int, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Finds the points that a view sees, without those that hide behind others.

    Args:
        scene: photographs, poses and lenses.
        index: of the view.
        points: (N, 3) in the scene's coordinates.

    Returns:
        Rows of the points, column and row of their pixels, and distances (n,) each.
    """
    camera, pose = scene.camera(index), scene.views[index].camera_from_world
    relative = points @ pose[:3, :3].T + pose[:3, 3]
    pixels, valid = camera.project(relative)
    x, y = np.ascontiguousarray(pixels.T)
    with np.errstate(invalid="ignore"):
        inside = (x >= 0) & (y >= 0) & (x < camera.width) & (y < camera.height)
    rows = np.flatnonzero(np.asarray(valid, bool) & inside)
    x, y = x[rows].astype(np.int64), y[rows].astype(np.int64)
    kept = scene.mask(index)[y, x]
    rows, x, y = rows[kept], x[kept], y[kept]
    away = np.linalg.norm(relative[rows], axis=1).astype(np.float32)
    longer = max(camera.width, camera.height)
    area = camera.width * camera.height * _PER_CELL / max(1, len(rows))
    side = min(max(1.0, np.sqrt(area)), longer / _WIDEST_CELL)
    columns = int(camera.width / side) + 1
    cell = (y / side).astype(np.int64) * columns + (x / side).astype(np.int64)
    nearest = np.full(int(cell.max(initial=0)) + 1, np.inf, np.float32)
    np.minimum.at(nearest, cell, away)
    seen = away <= _BEHIND * nearest[cell]
    return rows[seen], x[seen], y[seen], away[seen]
