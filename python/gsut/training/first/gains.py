"""Finds gains of photographs before training: a point has one colour in all that see it.

The logarithm of what a photograph shows of a point is the point's own colour, plus the photograph's
gain, plus the falloff at that place. Robust least squares find all of them from the points that
come with the poses, in a fraction of a second; a short run is over before its own images could show
them.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from gsut.data import Scene
from gsut.data.points import find_seen_points
from gsut.training.first.gains_in_time import interpolate_gains

# Photographs that are compared, evenly chosen; more cost time only.
_MOST_VIEWS = 150
# Points that are projected, so that near ones hide those behind.
_MOST_POINTS = 10_000
# Points that are compared: more would not change gains that stand out.
_MOST_COMPARED = 2_500
# Fewest photographs that decide: of fewer, points and gains cannot be separated.
_FEWEST_VIEWS = 5
# Fewest points that each photograph must show.
_FEWEST_SEEN = 60
# Photographs that must see a point: two agree for many reasons.
_SEEN_BY = 3
# Grey level above which a pixel is more than noise.
_DARKEST = 8
# Grey level below which a pixel is not clipped.
_BRIGHTEST = 245
# Areas along a photograph's longer side over which colours are averaged against noise.
_AREAS = 96
# Rounds of re-weighting, after which weights have settled.
_ROUNDS = 5
# Multiplications up to which OpenBLAS uses one thread.
_ALONE = 2**18
# Orders of the falloff: t^2 and t^4 of the distance from the image's middle.
_ORDERS = 2
# Ratio of the median errors with and without gains below which gains explain the colours.
_LEFT_OVER = 0.93
# Standard deviation of log-gains above which they differ: hidden or shining points explain less.
_DIFFER = 0.02


def find_first_gains(scene: Scene) -> np.ndarray | None:
    """Finds log-gains of the views if the scene's points show that they differ.

    Args:
        scene: as it is trained on; only its training photographs are used.

    Returns:
        (V, 3), of mean zero over the training views; other views take their neighbours' in time.
        None if the points do not clearly show that gains differ.
    """
    seen = _sample_points(scene)
    if seen is None:
        return None
    samples = seen.view, seen.point, seen.logs, seen.falloff
    gains, error = _fit_robustly(*samples, len(seen.views))
    _, without = _fit_robustly(*samples, 0)
    if gains.mean(axis=1).std() < _DIFFER or error > _LEFT_OVER * without:
        return None
    out = np.zeros((len(scene.views), 3))
    out[seen.views] = gains
    names = [each.name for each in scene.views]
    cameras = [each.camera_index for each in scene.views]
    out = interpolate_gains(out, seen.views.tolist(), names, cameras)
    return out - out[list(scene.train_indices)].mean(axis=0)


@dataclasses.dataclass(frozen=True)
class _PointColors:
    """Samples of the colours that photographs show at the scene's points.

    Attributes:
        views: (V,) the scene's views that were used.
        view, point: (n,) rows of `views`, and numbers of points from 0.
        logs: (3, n) logarithms of the colours.
        falloff: (orders, n) powers of the distance from the image's middle.
    """

    views: np.ndarray
    view: np.ndarray
    point: np.ndarray
    logs: np.ndarray
    falloff: np.ndarray


def _sample_points(scene: Scene) -> _PointColors | None:
    """Samples colours of points that `_SEEN_BY` training views see; None if there are too few."""
    train = np.array(scene.train_indices)
    views = train[np.unique(np.linspace(0, len(train) - 1, _MOST_VIEWS).round().astype(int))]
    if len(views) < _FEWEST_VIEWS or not len(scene.points):
        return None
    points = scene.points[:: -(-len(scene.points) // _MOST_POINTS)]
    seen = [_sample_view(scene, int(view), points) for view in views]
    view = np.repeat(np.arange(len(seen)), [len(rows) for rows, *_ in seen])
    point, colors, radius = (np.concatenate(column) for column in zip(*seen, strict=True))
    often = np.bincount(point, minlength=len(points))[point] >= _SEEN_BY
    view, rows = view[often], point[often]
    if np.bincount(view, minlength=len(views)).min() < _FEWEST_SEEN:
        return None
    logs = np.log(np.ascontiguousarray(colors[often].T))
    falloff = radius[often] ** (2 * np.arange(1, _ORDERS + 1)[:, None])
    point = np.unique(rows, return_inverse=True)[1]
    return _PointColors(views, view, point, logs, falloff)


def _sample_view(
    scene: Scene, view: int, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns rows, colours (n, 3) and distances from the middle of points that a view exposes
    well."""
    import cv2

    rows, x, y, _ = find_seen_points(scene, view, points)
    compared = rows % -(-len(points) // _MOST_COMPARED) == 0
    rows, x, y = rows[compared], x[compared], y[compared]
    image = scene.image(view)
    height, width = image.shape[:2]
    side = max(height, width) // _AREAS | 1
    colors = cv2.blur(image, (side, side))[y, x]
    good = (colors.min(axis=1) > _DARKEST) & (colors.max(axis=1) < _BRIGHTEST)
    radius = np.hypot(x[good] - width / 2, y[good] - height / 2) / np.hypot(width / 2, height / 2)
    return rows[good], colors[good] / 255.0, radius


def _fit_robustly(
    view: np.ndarray, point: np.ndarray, logs: np.ndarray, falloff: np.ndarray, num_views: int
) -> tuple[np.ndarray, float]:
    """Fits logs (3, n) = the point's + the view's + falloff (k, n) x its coefficients, robustly.

    Points are eliminated: what is fitted is each sample's difference from its point's mean.

    Args:
        view, point: (n,) of each sample.
        logs, falloff: see above.
        num_views: 0: views have no gains.

    Returns:
        (num_views, 3) of mean zero, and the median of the samples' largest errors.
    """
    num_points, weights = int(point.max()) + 1, np.ones(len(view))
    for _ in range(_ROUNDS):
        total = np.bincount(point, weights, num_points)
        right, basis = (
            _subtract_point_means(rows, point, weights, total) for rows in (logs, falloff)
        )
        weighted = weights * basis
        normal, side = (np.einsum("in,jn->ij", weighted, rows) for rows in (basis, right))
        if num_views:
            where = np.bincount(point * num_views + view, weights, num_points * num_views)
            where = where.reshape(num_points, num_views)
            shared = _multiply_in_parts(where, where / total[:, None])
            both = _sum_by(view, weighted, num_views)
            normal = np.block([[np.diag(where.sum(axis=0)) - shared, both.T], [both, normal]])
            side = np.concatenate([_sum_by(view, weights * right, num_views).T, side])
        # Gains are determined up to a common constant: lstsq takes the smallest solution.
        found = np.linalg.lstsq(normal, side, rcond=1e-9)[0]
        errors = right - np.einsum("kc,kn->cn", found[num_views:], basis)
        if num_views:
            errors -= _subtract_point_means(found[:num_views].T[:, view], point, weights, total)
        largest = np.abs(errors).max(axis=0)
        error = max(float(np.median(largest)), np.finfo(float).eps)
        weights = 1.0 / (1.0 + (largest / (1.4826 * error)) ** 2) ** 2  # Geman and McClure's
    gains = found[:num_views]
    return gains - gains.mean(axis=0) if num_views else gains, error


def _multiply_in_parts(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Returns the product (i, j) of a' (n, i) and b (n, j), in parts too small for BLAS' threads.

    Its threads would spin longer than they work.
    """
    rows = max(1, _ALONE // (a.shape[1] * b.shape[1]))
    return sum(
        (a[at : at + rows].T @ b[at : at + rows] for at in range(0, len(a), rows)),
        start=np.zeros((a.shape[1], b.shape[1])),
    )


def _subtract_point_means(
    rows: np.ndarray, point: np.ndarray, weights: np.ndarray, total: np.ndarray
) -> np.ndarray:
    """Subtracts from samples (k, n) the weighted mean of all samples of their point."""
    return rows - (_sum_by(point, weights * rows, len(total)) / total)[:, point]


def _sum_by(which: np.ndarray, rows: np.ndarray, count: int) -> np.ndarray:
    """Returns (k, count) sums of samples (k, n) over each value of `which` (n,)."""
    return np.stack([np.bincount(which, row, count) for row in rows])
