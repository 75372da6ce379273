"""Finds the distances that photographs show, by comparing them with their neighbours.

Each photograph is looked up in some neighbours where its own rays would meet them at one common
distance: spheres about the camera, so that any lens can be swept (Collins, "A space-sweep approach
to true multi-image matching", 1996). Distances that are alike beside each other cost least, along
eight directions (Hirschmüller, 2008), so that walls without texture take what their edges have. A
second sweep, at twice the size, also knows what the neighbours show: a surface where they see one
is likelier, one through which they see is not. Nothing is undistorted; a line of a rolling shutter
has its own pose.
"""

from __future__ import annotations

import concurrent.futures
import dataclasses
import functools
from collections.abc import Callable, Sequence

import numpy as np

from gsut import _core
from gsut.data import Scene
from gsut.sampling import choose_evenly
from gsut.surface.stereo.neighbours import MIDDLE, choose_neighbours
from gsut.surface.stereo.photograph import CELL, Photograph, shrink

# Longer side of the compared photographs in pixels, and distances that are tried, evenly in their
# inverse, in the first sweep and in the second: a pixel of parallax each, about.
_SWEEPS = ((100, 56), (200, 112))
# Distances that the first look tries, evenly in their inverse.
_LOOK_DEPTHS = 96
# Photographs of the first look, which finds the range of distances.
_LOOK_VIEWS = 5
# Nearest distance of the first look, x scene extent.
_LOOK_NEAR = 0.1
# Farthest distance of the first look, x scene extent.
_LOOK_FAR = 100.0
# Distances at which neighbours for the first look are chosen, x scene extent.
_LOOK_AT = (0.3, 1.0, 3.0)
# Least score of a distance that counts in the first look.
_LOOK_ALIKE = 0.5
# Percentiles of the inverse distances found that bound the range.
_RANGE = (2.0, 98.0)
# Factor by which the range is widened on both sides.
_WIDER = 1.25
# Least distance of a point from a camera, x scene extent.
_TINY = 1e-6
# Fewest distances, or points; if there are fewer, the photographs are not alike.
FEWEST = 100
# Standard deviation of noise in a window, grey values in [0, 1].
_CONTRAST = 0.015
# What a neighbour's surface at the tried distance adds, or takes away where it sees through it.
_AGREEMENT = 0.25
# Cost of a difference of one distance between neighbouring pixels: slanted surfaces.
_NEAR_STEP = 0.06
# Cost of any larger difference: edges.
_FAR_STEP = 0.5
# Difference of grey values at which an edge costs half.
_EDGE = 0.05
# Share of the inverse distance within which two photographs show the same where the distances that
# are tried are finer.
_WITHIN_SHARE = 0.02
# Other photographs that make a distance sure.
_SURE = 2.0


@dataclasses.dataclass(frozen=True)
class Shown:
    """What one view shows: inverse distances (H, W) float32, 0 where there is none; the number of
    other views that show the same surface there, and that of those that see through it."""

    photograph: Photograph
    inverse: np.ndarray
    agree: np.ndarray
    oppose: np.ndarray

    @property
    def trust(self) -> np.ndarray:
        """(H, W) float32 from 0 to 1."""
        return np.minimum(self.agree / np.float32(_SURE), 1).astype(np.float32)


OnView = Callable[[int, int], None]


def ignore_view(done: int, total: int) -> None: ...


def find_distances(
    scene: Scene, views: Sequence[int], on_view: OnView = ignore_view
) -> dict[int, Shown]:
    """Finds what views show.

    Args:
        scene: with known poses and lenses; its training views are the neighbours.
        views: indices of the views.
        on_view: called with the number of sweeps done and of all.

    Returns:
        What each view shows, at 200 pixels; empty where hardly anything in photographs is alike.
    """
    shown: dict[int, Shown] = {}
    for number, (side, depths) in enumerate(_SWEEPS):
        small = shrink(scene, side)
        photographs = {view: Photograph(small, view) for view in small.train_indices} | {
            view: Photograph(small, view) for view in views if view not in small.train_indices
        }
        if number == 0:
            found = _find_range(small, photographs)
            if found is None:
                return {}
            inverse, at = found
        tried = np.linspace(inverse[0], inverse[1], depths)

        def sweep(
            view: int, small=small, photographs=photographs, tried=tried, shown=shown, at=at
        ) -> np.ndarray:
            beside = choose_neighbours(small, view, photographs[view], at)
            return _sweep(view, beside, photographs, tried, shown)

        pictures: dict[int, np.ndarray] = {}
        with concurrent.futures.ThreadPoolExecutor(_core.num_threads()) as threads:
            for view, picture in zip(views, threads.map(sweep, views), strict=True):
                pictures[view] = picture
                on_view(number * len(views) + len(pictures), len(_SWEEPS) * len(views))
            step = float(tried[0] - tried[1])
            compare = functools.partial(
                _compare, pictures=pictures, photographs=photographs, step=step
            )
            checks = threads.map(compare, views)
            shown = {
                view: Shown(photographs[view], pictures[view], *counts)
                for view, counts in zip(views, checks, strict=True)
            }
    return shown


def _find_range(
    scene: Scene, photographs: dict[int, Photograph]
) -> tuple[tuple[float, float], list[float]] | None:
    """Finds the largest and the smallest inverse distance, and distances of most of what is seen.

    They are those of the dataset's points; if these are too few, of what a first look at some
    photographs finds. None if that is too little.
    """
    train, extent = scene.train_indices, scene.extent
    if len(scene.points) >= FEWEST:
        centers = np.stack([scene.views[view].camera_center for view in train])
        away = np.linalg.norm(scene.points[None] - centers[:, None], axis=2)
        found = 1 / np.maximum(away, _TINY * extent).ravel()
    else:
        tried = np.linspace(1 / _LOOK_NEAR, 1 / _LOOK_FAR, _LOOK_DEPTHS) / extent
        parts = []
        for view in choose_evenly(train, _LOOK_VIEWS):
            beside = choose_neighbours(
                scene, view, photographs[view], [extent * share for share in _LOOK_AT]
            )
            inverse, score = _match(view, beside, photographs, tried, {})
            inside = (inverse < tried[1]) & (inverse > tried[-2]) & (score > _LOOK_ALIKE)
            parts.append(inverse[inside & photographs[view].mask])
        found = np.concatenate(parts)
        if len(found) < FEWEST:
            return None
    far, near = np.percentile(found, _RANGE)
    middle = (1 / np.percentile(found, MIDDLE)).tolist()
    return (float(near) * _WIDER, float(far) / _WIDER), middle


def _sweep(
    view: int, beside: list[int], photographs: dict[int, Photograph], tried: np.ndarray,
    shown: dict[int, Shown],
) -> np.ndarray:  # fmt: skip
    """Returns the inverse distances (H, W) float32 that a view shows, 0 where there is none."""
    if not beside:
        return np.zeros(photographs[view].grey.shape, np.float32)
    return _match(view, beside, photographs, tried, shown)[0]


def _match(
    view: int, beside: list[int], photographs: dict[int, Photograph], tried: np.ndarray,
    shown: dict[int, Shown],
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Returns the inverse distances (H, W) that suit best, and their scores."""
    own = photographs[view]
    starts, rays, cells = own.trace_cells()
    points = (starts + rays / tried[:, None, None]).reshape(-1, 3)
    sweep = _core.Sweep(own.grey, len(tried), CELL)
    for row in beside:
        other = photographs[row]
        pixels, nearness = other.project(points)
        known: list[np.ndarray | None] = [None, None, None]
        if row in shown:
            size = other.grey.shape
            known = [
                nearness.astype(np.float32).reshape(len(tried), *cells),
                _resize(shown[row].inverse, size),
                _resize(shown[row].trust, size),
            ]
        places = pixels.astype(np.float32).reshape(len(tried), *cells, 2)
        sweep.add(other.grey, places, *known)
    step = float(tried[0] - tried[1])
    best, score = sweep.solve(
        own.mask, contrast=_CONTRAST, step=step, agreement=_AGREEMENT, near_step=_NEAR_STEP,
        far_step=_FAR_STEP, edge=_EDGE,
    )  # fmt: skip
    inverse = np.where(own.mask, tried[0] - best * step, 0).astype(np.float32)
    return inverse, score


def _resize(picture: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    import cv2

    return cv2.resize(picture, size[::-1], interpolation=cv2.INTER_NEAREST)


def _compare(
    view: int, pictures: dict[int, np.ndarray], photographs: dict[int, Photograph], step: float
) -> tuple[np.ndarray, np.ndarray]:
    """Counts the other views that show the same surface at each pixel, and that see through it."""
    picture = pictures[view]
    agree, oppose = np.zeros((2, *picture.shape), np.uint8)
    rows, columns = np.nonzero(picture > 0)
    starts, rays = photographs[view].trace_rays(np.stack([columns, rows], axis=1) + 0.5)
    points = starts + rays / picture[rows, columns][:, None]
    for row, other in pictures.items():
        if row == view:
            continue
        pixels, inverse = photographs[row].project(points)
        seen = photographs[row].is_inside(pixels)
        x, y = np.where(seen[:, None], pixels, 0).astype(int).T
        there = np.where(seen, other[y, x], 0)
        within = np.maximum(step, _WITHIN_SHARE * there)
        off = inverse - there
        agree[rows, columns] += (there > 0) & (np.abs(off) < within)
        oppose[rows, columns] += (there > 0) & (off > 2 * within)
    return agree, oppose
