"""Finds first points by a plane sweep over neighbouring photographs if the data have too few.

Each of some photographs is compared with a few neighbours, looked up where its own rays would meet
them at one common distance: spheres about the camera, so that any lens can be swept. The distance
at which small windows correlate best is taken (Collins, "A space-sweep approach to true multi-image
matching", 1996). Nothing is undistorted; a line of a rolling shutter has its own pose.
"""

from __future__ import annotations

import concurrent.futures
import dataclasses
from typing import Any

import numpy as np

from gsut import _core
from gsut.data import Scene
from gsut.data.scene import project_points
from gsut.gaussians import choose_points
from gsut.surface.stereo import Photograph, shrink

# Longer side of the compared photographs in pixels: a sweep of larger ones takes longer, and
# Gaussians grow to the detail themselves.
_LONGER_SIDE = 160
# Number of photographs up to which all get distances.
_FEWEST_VIEWS = 20
# Most photographs that get distances; in between, a quarter of all, evenly chosen.
_MOST_VIEWS = 100
# Neighbours that each is compared with. The best two count: one may be hidden.
_NEIGHBOURS = 3
# Distances that are tried, evenly in their inverse.
_SPHERES = 48
# Distances that are tried at once, which fit into the cache.
_AT_ONCE = 6
# Pixels a side of the cells between whose centres the lens' projection is interpolated.
_CELL = 4
# Pixels a side of the windows that are correlated.
_WINDOW = 5
# Coordinate of a pixel that lies in no photograph.
_OUTSIDE = -1e4
# Least correlation of a match; a stricter limit leaves fewer points and a worse start.
_ALIKE = 0.6
# Least standard deviation in a window, values in [0, 1]: less is noise.
_TEXTURE = 0.01
# Variance below which a neighbour's window is plain.
_BLACK = 1e-6
# Least cosine between the axes of neighbours.
_FACING = 0.5
# Photographs of the first look, which finds the range of distances.
_LOOK_VIEWS = 5
# Distances that the first look tries, evenly in their inverse.
_LOOK_SPHERES = 96
# Nearest distance of the first look, x scene extent.
_LOOK_NEAR = 0.1
# Farthest distance of the first look, x scene extent.
_LOOK_FAR = 100.0
# Baseline of neighbours, x scene extent in the first look, then x median distance found.
_BASELINE = 0.15
# Percentiles of the inverse distances found that bound the range.
_RANGE = (2.0, 98.0)
# Factor by which the range is widened on both sides.
_WIDER = 1.25
# Least distance of a point from a camera, x scene extent.
_TINY = 1e-6
# Fewest points; if there are fewer, the photographs are not alike.
_FEWEST = 100
# Other photographs that must agree if there are few: chance agrees with one.
_AGREE_OF_FEW = 2
# Other photographs that must agree if there are many, where few see a background.
_AGREE = 1
# Most training views that count as few.
_FEW_VIEWS = 16
# Spheres within which photographs agree, at the pixel that shows the point or beside it.
_WITHIN = 1.0
# Points that are checked for each one requested, at most.
_CHECKED = 4


@dataclasses.dataclass(frozen=True)
class _Spheres:
    """Distances to try: inverse distances (D,), falling, and the baseline between neighbours."""

    inverse: np.ndarray
    baseline: float


@dataclasses.dataclass(frozen=True)
class _Found:
    """Points found in a view: positions (n, 3), colours (n, 3), inverse distances (n,), and these
    as a picture (H, W) float32, 0 without a point."""

    points: np.ndarray
    colors: np.ndarray
    inverse: np.ndarray
    picture: np.ndarray


class _Photograph(Photograph):
    """A view prepared for comparison: with mean and deviation of its grey values in each window."""

    def __init__(self, scene: Scene, view: int) -> None:
        super().__init__(scene, view)
        self.mean, squares = _average_windows(self.grey), _average_windows(self.grey**2)
        self.deviation = np.sqrt(np.maximum(squares - self.mean**2, 0))


def find_points_by_sweep(
    scene: Scene, most: int, seed: int
) -> tuple[np.ndarray, np.ndarray] | None:
    """Finds points on what training photographs show, from poses and lenses alone.

    Args:
        scene: as it is trained on.
        most: number of points, drawn from those found.
        seed: of the draw.

    Returns:
        Points (N, 3) in the scene's coordinates, and colours (N, 3) uint8. None if hardly anything
        in neighbouring photographs is alike.
    """
    small = shrink(scene, _LONGER_SIDE)
    between = _find_range(small)
    if between is None:
        return None
    near, far, middle = between
    spheres = _Spheres(np.linspace(near * _WIDER, far / _WIDER, _SPHERES), _BASELINE / middle)
    views = min(max(_FEWEST_VIEWS, len(scene.train_indices) // 4), _MOST_VIEWS)
    found = _sweep(small, views, spheres)
    points, colors = _keep_agreed(small, found, spheres, _CHECKED * most, seed)
    if len(points) < _FEWEST:
        return None
    rows = choose_points(len(points), most, seed)
    return points[rows], colors[rows]


def _find_range(scene: Scene) -> tuple[float, float, float] | None:
    """Finds inverse distances: about the largest, about the smallest, and the median.

    They are those of the dataset's points; if these are too few, of what a first look at some
    photographs finds. None if that is too little.
    """
    train = scene.train_indices
    if len(scene.points) >= _FEWEST:
        centers = np.stack([scene.views[view].camera_center for view in train])
        away = scene.points[None] - centers[:, None]
        found = 1 / np.maximum(np.linalg.norm(away, axis=2), _TINY * scene.extent).ravel()
    else:
        look = np.linspace(1 / _LOOK_NEAR, 1 / _LOOK_FAR, _LOOK_SPHERES) / scene.extent
        seen = _sweep(scene, _LOOK_VIEWS, _Spheres(look, _BASELINE * scene.extent))
        found = np.concatenate([each.inverse for each in seen.values()])
        if len(found) < _FEWEST:
            return None
    far, near = np.percentile(found, _RANGE)
    return float(near), float(far), float(np.median(found))


def _keep_agreed(
    scene: Scene, found: dict[int, _Found], spheres: _Spheres, most: int, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """Draws points and colours, and keeps those that enough other views show, too.

    If hardly any would be kept, as with three or four views, fewer views suffice.
    """
    points, colors = (
        np.concatenate([getattr(each, name) for each in found.values()])
        for name in ("points", "colors")
    )
    owner = np.repeat(list(found), [len(each.points) for each in found.values()])
    rows = choose_points(len(points), most, seed)
    points, colors, owner = points[rows], colors[rows], owner[rows]
    step = _WITHIN * abs(spheres.inverse[1] - spheres.inverse[0])
    agree = np.zeros(len(points), np.int64)
    for view, other in found.items():
        agree += (owner != view) & _find_agreement(scene, view, other.picture, points, step)
    needed = _AGREE_OF_FEW if len(scene.train_indices) <= _FEW_VIEWS else _AGREE
    while needed > 0 and np.count_nonzero(agree >= needed) < _FEWEST:
        needed -= 1
    sure = agree >= needed
    return points[sure], colors[sure]


def _find_agreement(
    scene: Scene, view: int, picture: np.ndarray, points: np.ndarray, step: float
) -> np.ndarray:
    """Returns (n,) bool: whether a picture of inverse distances shows the points (n, 3).

    It does if the inverse distance at a point's pixel, or beside it, differs by less than `step`.
    """
    in_camera, pixels, valid = project_points(scene.camera(view), scene.views[view].motion, points)
    with np.errstate(invalid="ignore", divide="ignore"):
        inverse = 1 / np.linalg.norm(in_camera, axis=1)
        size = np.array(picture.shape[::-1])
        valid = valid & np.all((pixels >= 0) & (pixels < size), axis=1)
    column, row = np.where(valid[:, None], pixels, 0.0).astype(np.int64).T
    around = np.pad(picture, 1)  # 0 beyond the border
    shows = np.zeros(len(points), bool)
    for down in range(3):
        for right in range(3):
            there = around[row + down, column + right]
            shows |= (there > 0) & (np.abs(there - inverse) < step)
    return shows & valid


def _sweep(scene: Scene, views: int, spheres: _Spheres) -> dict[int, _Found]:
    """Finds points in some views, evenly chosen; returns them by view."""
    train = scene.train_indices
    chosen = np.unique(np.linspace(0, len(train) - 1, min(views, len(train))).round().astype(int))

    def sweep_view(place: int) -> _Found:
        neighbours = _choose_neighbours(scene, train[place], spheres.baseline)
        beside = [_Photograph(scene, row) for row in neighbours]
        return _find_distances(_Photograph(scene, train[place]), beside, spheres.inverse)

    with concurrent.futures.ThreadPoolExecutor(_core.num_threads()) as threads:
        return dict(
            zip((train[place] for place in chosen), threads.map(sweep_view, chosen), strict=True)
        )


def _choose_neighbours(scene: Scene, view: int, baseline: float) -> list[int]:
    """Returns the training views that look the same way from about `baseline` away."""
    rows = [row for row in scene.train_indices if row != view]
    own = scene.views[view]
    away = [np.linalg.norm(scene.views[row].camera_center - own.camera_center) for row in rows]
    axis = own.camera_from_world[2, :3]
    facing = np.array([scene.views[row].camera_from_world[2, :3] @ axis for row in rows])
    with np.errstate(divide="ignore"):
        cost = np.abs(np.log(np.array(away) / baseline)) + 2 * (1 - facing)
    cost[facing < _FACING] = np.inf
    best = np.argsort(cost, kind="stable")[:_NEIGHBOURS]
    return [rows[place] for place in best if np.isfinite(cost[place])]


def _find_distances(view: _Photograph, beside: list[_Photograph], inverse: np.ndarray) -> _Found:
    """Finds points in one view by comparing it with its neighbours."""
    picture = np.zeros(view.grey.shape, np.float32)
    if len(beside) < 2:
        return _Found(np.zeros((0, 3)), np.zeros((0, 3), np.uint8), np.zeros(0), picture)
    scores = _score_distances(view, beside, inverse)
    last = len(inverse) - 1
    best = scores.argmax(axis=0)
    top, before, after = (
        np.take_along_axis(scores, np.clip(best + step, 0, last)[None], axis=0)[0]
        for step in (0, -1, 1)
    )
    margin = _WINDOW // 2 + _CELL // 2  # around the image, where windows show what lies beside it
    sure = np.zeros(best.shape, bool)
    sure[margin:-margin, margin:-margin] = True
    sure &= view.mask & (top > _ALIKE) & (view.deviation > _TEXTURE) & (best > 0) & (best < last)
    rows, columns = np.nonzero(sure)
    top, before, after = (each[sure].astype(np.float64) for each in (top, before, after))
    bend = np.minimum(before + after - 2 * top, -np.finfo(np.float32).eps)
    between = np.clip((before - after) / (2 * bend), -0.5, 0.5)  # the parabola's vertex
    nearness = inverse[0] + (best[sure] + between) * (inverse[1] - inverse[0])
    starts, rays = view.trace_rays(np.stack([columns, rows], axis=1) + 0.5)
    has_ray = np.isfinite(rays).all(axis=1)
    points, rows, columns = (
        (starts + rays / nearness[:, None])[has_ray],
        rows[has_ray],
        columns[has_ray],
    )
    picture[rows, columns] = nearness[has_ray]
    return _Found(points, view.color[rows, columns], nearness[has_ray], picture)


def _score_distances(
    view: _Photograph, beside: list[_Photograph], inverse: np.ndarray
) -> np.ndarray:
    """Returns (D, H, W) float32: mean of the best two correlations with neighbours at each
    distance."""
    import cv2

    height, width = view.grey.shape
    rows, columns = -(-height // _CELL), -(-width // _CELL)
    y, x = np.mgrid[0:rows, 0:columns]
    starts, rays = view.trace_rays(np.stack([x.ravel(), y.ravel()], axis=1) * _CELL + _CELL / 2)
    sharp = 1 / (view.deviation + np.float32(_TEXTURE / 10))
    scores = np.empty((len(inverse), height, width), np.float32)
    for begin in range(0, len(inverse), _AT_ONCE):
        part = slice(begin, begin + _AT_ONCE)
        points = (starts + rays / inverse[part, None, None]).reshape(-1, 3)
        best, second = np.float32(-1), np.float32(-1)
        for other in beside:
            places = _look_up_places(other, points, (-1, rows, columns), (height, width))
            seen = cv2.remap(
                other.grey, places[0], places[1], cv2.INTER_LINEAR, borderValue=0
            ).reshape(-1, height, width)
            alike = _correlate_windows(view, seen) * sharp
            second = np.maximum(second, np.minimum(best, alike))
            best = np.maximum(best, alike)
        scores[part] = 0.5 * (best + second)
    return scores


def _look_up_places(
    other: _Photograph, points: np.ndarray, cells: tuple[int, int, int], size: tuple[int, int]
) -> list[np.ndarray]:
    """Returns the pixels at which a photograph shows points (n, 3), one for each cell.

    Between cells they are interpolated: columns and rows, each (spheres x height, width) float32,
    as OpenCV counts pixels.
    """
    import cv2

    _, pixels, valid = project_points(other.camera, other.motion, points)
    pixels = np.where(valid[:, None], pixels - 0.5, _OUTSIDE).astype(np.float32)
    places = []
    for along in pixels.T:
        at = along.reshape(-1, cells[2])
        spread = cv2.resize(at, None, fx=_CELL, fy=_CELL, interpolation=cv2.INTER_LINEAR)
        spheres = spread.reshape(-1, _CELL * cells[1], _CELL * cells[2])
        near = np.ascontiguousarray(spheres[:, : size[0], : size[1]])
        places.append(near.reshape(-1, size[1]))
    return places


def _correlate_windows(view: _Photograph, seen: np.ndarray) -> np.ndarray:
    """Returns (n, H, W): covariance of windows of the view and of pictures `seen`, over the
    latter's standard deviation."""
    shape = seen.shape
    mean = _average_windows(seen.reshape(-1, shape[2])).reshape(shape)
    squares = _average_windows((seen * seen).reshape(-1, shape[2])).reshape(shape)
    products = _average_windows((seen * view.grey).reshape(-1, shape[2])).reshape(shape)
    products -= mean * view.mean
    squares -= mean * mean
    products /= np.sqrt(np.maximum(squares, np.float32(_BLACK)))
    return products


def _average_windows(values: Any) -> np.ndarray:
    import cv2

    return cv2.blur(values, (_WINDOW, _WINDOW))
