"""Colours of points from the photographs that see them, such as of a LiDAR's cloud."""

from __future__ import annotations

import numpy as np

from gsut.bounds import name_wrong_kinds
from gsut.data.points.ply import NO_COLOR
from gsut.data.scene import Scene, find_visible_points
from gsut.run import Progress
from gsut.sampling import choose_evenly

_MOST_VIEWS = 150  # evenly chosen: more change the colours little
_SLOTS = 7  # nearest photographs of a point: their median is its colour
_IN_CELL = 3  # points in a cell on average, of which those near the nearest one are seen
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
    chosen = choose_evenly(range(len(scene)), _MOST_VIEWS)
    for index in Progress(progress).iterate("colours", chosen):
        rows, places, away = find_visible_points(scene, index, points, _IN_CELL)
        x, y = (places * [scene.camera(index).width, scene.camera(index).height]).astype(int).T
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
