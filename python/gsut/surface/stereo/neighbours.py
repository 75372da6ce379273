"""Chooses the views that a view is compared with: those that see its rays from other angles."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gsut.data import Scene
from gsut.data.scene import project_points
from gsut.surface.stereo.photograph import Photograph

# Percentiles of a view's depths at which its neighbours are chosen.
MIDDLE = (15.0, 50.0, 85.0)
# Most neighbours: of them the best three count, as some see something else.
_MOST = 6
# Rays a side of the view that neighbours are chosen by.
_RAYS = 12
# Degrees between two rays to a point, from which it is located well.
_ENOUGH = 5.0
# Degrees above which windows look less and less alike.
_WIDE = 25.0
# Degrees above which windows look alike by chance alone.
_TOO_WIDE = 60.0
# Neighbours that each ray needs: more of the same add nothing.
_NEEDED = 2.5
# Least gain of another neighbour: no ray seen.
_LEAST = 1e-3


def choose_neighbours(
    scene: Scene, view: int, photograph: Photograph, distances: Sequence[float]
) -> list[int]:
    """Chooses training views that together see what a view sees, at angles that locate it.

    Args:
        scene: at the size of the comparison.
        view: whose neighbours are chosen.
        photograph: of the view.
        distances: at which points on its rays may lie.

    Returns:
        Indices of views, the most useful first.
    """
    starts, rays = _trace_some(photograph)
    points = np.concatenate([starts + rays * distance for distance in distances])
    own = points - np.tile(starts, (len(distances), 1))
    rows = [row for row in scene.train_indices if row != view]
    worth = np.array([_weigh_angles(scene, row, points, own) for row in rows])
    chosen: list[int] = []
    seen = np.zeros(len(points))
    while len(chosen) < min(_MOST, len(rows)):
        gain = (np.minimum(seen + worth, _NEEDED) - np.minimum(seen, _NEEDED)).sum(axis=1)
        gain[chosen] = 0.0
        best = int(gain.argmax())
        if gain[best] < _LEAST:
            break
        chosen.append(best)
        seen += worth[best]
    return [rows[place] for place in chosen]


def _trace_some(photograph: Photograph) -> tuple[np.ndarray, np.ndarray]:
    height, width = photograph.grey.shape
    y, x = (np.mgrid[0:_RAYS, 0:_RAYS].reshape(2, -1) + 0.5) / _RAYS
    pixels = np.stack([x * width, y * height], axis=1)
    column, row = pixels.astype(int).T
    starts, rays = photograph.trace_rays(pixels[photograph.mask[row, column]])
    good = np.isfinite(rays).all(axis=1)
    return starts[good], rays[good]


def _weigh_angles(scene: Scene, row: int, points: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Returns (n,) what a view adds to each point: 1 at a good angle, 0 if it is unseen."""
    camera, view = scene.camera(row), scene.views[row]
    _, pixels, valid = project_points(camera, view.motion, points)
    with np.errstate(invalid="ignore"):
        inside = valid & ((pixels >= 0) & (pixels < (camera.width, camera.height))).all(axis=1)
    other = points - view.camera_center
    lengths = np.linalg.norm(own, axis=1) * np.linalg.norm(other, axis=1)
    cosine = np.einsum("ni,ni->n", own, other) / np.maximum(lengths, np.finfo(float).tiny)
    angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    near, far = angle / _ENOUGH, (_TOO_WIDE - angle) / (_TOO_WIDE - _WIDE)
    return np.where(inside, np.clip(np.minimum(near, far), 0, 1), 0.0)
