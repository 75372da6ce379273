"""Follows pixels of posed photographs into their neighbours by optical flow: dense matches.

A neighbour is first drawn as the photograph's own lens and pose would see it, at distances that
known points give; what flow has to find is then small, whatever the turn and the distortion.
"""

from __future__ import annotations

import concurrent.futures
import dataclasses
import itertools
import math
from typing import Any

import numpy as np

from gsut import _core
from gsut.data import Scene
from gsut.data.images import shrink_image, shrink_mask
from gsut.sfm.photographs import OnProgress

_MEGAPIXELS = 0.5  # of the images that flow is computed on: more costs time and gains little
_NEIGHBORS = 4  # of each photograph
_SHARED = 15  # points that two neighbours must both see
_LEAST_ANGLE = 1.5  # degrees between two neighbours' rays to a point: enough for a distance
_MOST_ANGLE = 20.0  # degrees between two neighbours' rays: a patch still looks alike
_AT_ONCE = 30_000  # places: cv2.remap takes less than 2^15
_SMOOTH = 20  # parts of the longer side, over one of which distances are averaged
_RETURN_PX = 0.7  # of the small images, between a pixel and where flow there and back leads


@dataclasses.dataclass(frozen=True)
class Flow:
    """Pixels of all views, and the pairs of them that show the same point.

    Args:
        pixels: (N, 2) float64 of each view, at the size of the files.
        colors: (N, 3) uint8 of each view.
        matches: first view, second view, (M, 2) int32 into the pixels of both; first < second.
    """

    pixels: list[np.ndarray]
    colors: list[np.ndarray]
    matches: list[tuple[int, int, np.ndarray]]


def follow_pixels(
    scene: Scene,
    positions: np.ndarray,
    observations: np.ndarray,
    pixels: list[np.ndarray],
    count: int,
    on_progress: OnProgress,
) -> Flow:
    """Follows pixels by dense inverse search (Kroeger et al. 2016), checked there and back.

    Args:
        scene: the photographs.
        positions: (P, 3) of known points, which give neighbours and distances.
        observations: (S, 3) point, view, pixel of the known points.
        pixels: (N, 2) of each view, that the observations name.
        count: pixels to follow, of all views together.
        on_progress: called for the stage "flow".
    """
    import cv2

    of_view = [observations[observations[:, 1] == index] for index in range(len(scene))]
    small = [
        _Small(scene, index, positions[rows[:, 0]], pixels[index][rows[:, 2]])
        for index, rows in enumerate(of_view)
    ]
    step = math.sqrt(sum(float(s.valid.sum()) for s in small) / max(1, count))
    grids = [s.make_grid(max(1.0, step)) for s in small]
    wanted = _choose_neighbors(scene, positions, of_view)
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)  # its result depends on the number of threads
    try:
        with concurrent.futures.ThreadPoolExecutor(_core.num_threads()) as pool:
            neighbors = ([small[b] for b in others] for others in wanted)
            found = []
            for each in pool.map(_follow, small, neighbors, grids):  # an error drops the rest
                found.append(each)
                on_progress("flow", len(found), len(wanted), "")
    finally:
        cv2.setNumThreads(before)
    places = [[grid] for grid in grids]
    counts = [len(grid) for grid in grids]
    matches = []
    followed = [
        (a, b, *result)
        for a, others in enumerate(wanted)
        for b, result in zip(others, found[a], strict=True)
    ]
    for a, b, rows, arrived in followed:
        there = counts[b] + np.arange(len(rows))
        places[b].append(arrived)
        counts[b] += len(rows)
        both = np.stack([rows, there], axis=1).astype(np.int32)
        matches.append((a, b, both) if a < b else (b, a, np.ascontiguousarray(both[:, ::-1])))
    of_views = [np.concatenate(each) for each in places]
    colors = [s.sample_colors(each) for s, each in zip(small, of_views, strict=True)]
    return Flow([e * s.factor for e, s in zip(of_views, small, strict=True)], colors, matches)


class _Small:
    """A view's photograph at the size that flow is computed at.

    Args:
        points: (N, 3) that the view sees.
        seen: (N, 2) pixels of the full image where it sees them.
    """

    def __init__(self, scene: Scene, index: int, points: np.ndarray, seen: np.ndarray) -> None:
        import cv2

        full = scene.image(index)
        height, width = full.shape[:2]
        scale = min(1.0, math.sqrt(_MEGAPIXELS * 1e6 / (width * height)))
        size = max(1, round(scale * width)), max(1, round(scale * height))
        self.image = shrink_image(full, *size)
        self.grey = cv2.cvtColor(self.image, cv2.COLOR_RGB2GRAY)
        self.valid = shrink_mask(scene.mask(index), *size)
        view = scene.views[index]
        file = scene.file_cameras[view.camera_index]
        self.factor = np.array([file.width / size[0], file.height / size[1]])
        self.camera, self.pose = file.resize(*size), view.camera_from_world
        self._distances = np.linalg.norm(points - view.camera_center, axis=1)
        self._seen = np.clip((seen / self.factor).astype(int), 0, np.array(size) - 1)

    def estimate_points(self) -> np.ndarray:
        """Estimates (H, W, 3) the point of each pixel from known points beside it."""
        import cv2

        far = np.full(self.valid.shape, 255, np.uint8)
        x, y = self._seen.T
        far[y, x] = 0
        labels = cv2.distanceTransformWithLabels(
            far, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
        )[1]
        lengths = np.zeros(labels.max() + 1, np.float32)
        lengths[labels[y, x]] = self._distances
        around = 2 * (max(self.valid.shape) // _SMOOTH // 2) + 1
        distance = cv2.blur(lengths[labels], (around, around))
        rays = np.nan_to_num(self.camera.rays()[0])
        return (rays * distance[..., None] - self.pose[:3, 3]) @ self.pose[:3, :3]

    def make_grid(self, step: float) -> np.ndarray:
        """Returns (N, 2) valid pixels that are `step` apart."""
        height, width = self.valid.shape
        x, y = np.meshgrid(np.arange(step / 2, width, step), np.arange(step / 2, height, step))
        places = np.stack([x.ravel(), y.ravel()], axis=1)
        return places[self.is_valid_at(places)]

    def is_valid_at(self, places: np.ndarray) -> np.ndarray:
        """Returns (N,) bool: inside the image, and valid."""
        height, width = self.valid.shape
        inside = np.all((places >= 0) & (places < [width, height]), axis=1)
        x, y = np.where(inside[:, None], places, 0).astype(int).T
        return inside & self.valid[y, x]

    def sample_colors(self, places: np.ndarray) -> np.ndarray:
        x, y = places.astype(int).T
        return self.image[y, x]


def _follow(
    a: _Small, others: list[_Small], grid: np.ndarray
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Follows the grid of `a` into others; returns the rows found there, and their places."""
    points = a.estimate_points().reshape(-1, 3) if others else np.zeros((0, 3))
    return [_follow_into(a, b, points, grid) for b in others]


def _follow_into(
    a: _Small, b: _Small, points: np.ndarray, grid: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    import cv2

    height, width = a.valid.shape
    place, known = b.camera.project(points @ b.pose[:3, :3].T + b.pose[:3, 3])
    place = np.where(np.asarray(known)[:, None], place, -1.0).reshape(height, width, 2)
    at = (place - 0.5).astype(np.float32)
    moved = cv2.remap(b.grey, at[..., 0], at[..., 1], cv2.INTER_LINEAR)
    search: Any = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    there, back = search.calc(a.grey, moved, None), search.calc(moved, a.grey, None)
    reached = grid + _sample_image(there, grid)
    returned = reached + _sample_image(back, reached)
    arrived = _sample_image(place.astype(np.float32), reached)
    good = (np.linalg.norm(returned - grid, axis=1) < _RETURN_PX) & b.is_valid_at(arrived)
    return np.flatnonzero(good), arrived[good]


def _sample_image(values: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Samples (N, 2) of values (H, W, 2) at places; pixel centres are at (0.5, 0.5)."""
    import cv2

    if not len(places):
        return np.zeros((0, 2))
    at = (places - 0.5).astype(np.float32)[None]
    found = [
        cv2.remap(
            values, part[..., 0], part[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        for part in np.array_split(at, -(-len(places) // _AT_ONCE), axis=1)
    ]
    return np.concatenate(found, axis=1)[0].astype(np.float64)


def _choose_neighbors(
    scene: Scene, positions: np.ndarray, of_view: list[np.ndarray]
) -> list[list[int]]:
    """Chooses the views that share most points with each view and see them from another side."""
    shared = np.zeros((len(scene), len(scene)))
    for a, b in itertools.combinations(range(len(scene)), 2):
        points = np.intersect1d(of_view[a][:, 0], of_view[b][:, 0])
        if len(points) < _SHARED:
            continue
        rays = [positions[points] - scene.views[i].camera_center for i in (a, b)]
        lengths = np.prod([np.linalg.norm(each, axis=1) for each in rays], axis=0)
        angles = np.arccos(np.clip(np.einsum("ni,ni->n", *rays) / lengths, -1, 1))
        if _LEAST_ANGLE < np.degrees(np.median(angles)) < _MOST_ANGLE:
            shared[a, b] = shared[b, a] = len(points)
    order = np.argsort(-shared, axis=1, kind="stable")[:, :_NEIGHBORS]
    return [[int(b) for b in row if shared[a, b]] for a, row in enumerate(order)]
