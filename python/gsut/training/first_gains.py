"""Gains of photographs before anything is trained: a point has one colour in all that see it.

The logarithm of what a photograph shows of a point is the point's own colour, plus the
photograph's gain, plus the falloff where it is seen. Robust least squares find all of them from
the points that come with the poses, in a fraction of a second; a short run is over before its own
images could tell.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from gsut.data import Scene
from gsut.data.points import find_seen_points
from gsut.render import interpolated_gains

_MOST_VIEWS = 150  # photographs that are looked at, evenly chosen
_MOST_POINTS, _MOST_COMPARED = 10_000, 2_500  # that hide each other; of them compared
_FEWEST_VIEWS, _FEWEST_SEEN = 5, 60  # photographs, and points of each, below which nothing is said
_SEEN_BY = 3  # photographs, or a point says nothing
_DARKEST, _BRIGHTEST = 8, 245  # grey levels that are neither noise nor clipped
_AREAS = 96  # along a photograph's longer side: over one colours are averaged
_ROUNDS = 5  # of re-weighting
_ALONE = 2**18  # multiplications that OpenBLAS does on one thread
_ORDERS = 2  # of the falloff: of t^2 and t^4 in the distance from the image's middle
# Gains are believed that bring the points' colours this much closer together (fox: 0.76 of the
# median error is left), and whose standard deviation is more than hidden or shining points explain
# (1.6 % on a made scene whose photographs are alike, where the error grows to 1.12).
_LEFT_OVER, _DIFFER = 0.93, 0.02


def first_gains(scene: Scene) -> np.ndarray | None:
    """Log-gains of the views, where the scene's points show that they differ.

    Args:
        scene: as it is trained on; only its training photographs are looked at.

    Returns:
        (V, 3), of mean zero over the training views; of views that were not looked at those of
        their neighbours in time. None where the points do not show for certain that gains differ.
    """
    seen = colors_of_points(scene, _SEEN_BY)
    if seen is None:
        return None
    gains, are_certain = gains_of(seen)
    if not are_certain:
        return None
    out = np.zeros((len(scene.views), 3))
    out[seen.views] = gains
    names = [each.name for each in scene.views]
    cameras = [each.camera_index for each in scene.views]
    out = interpolated_gains(out, seen.views.tolist(), names, cameras)
    return out - out[list(scene.train_indices)].mean(axis=0)


@dataclasses.dataclass(frozen=True)
class PointColors:
    """What photographs show of the scene's points, a sample each.

    Attributes:
        views: (V,) of the scene, that were looked at.
        view, point: (n,) rows of `views`, and numbers of points, from 0 on.
        positions: (n, 3) of the samples' points.
        logs: (3, n) logarithms of the colours.
        falloff: (orders, n) powers of the distance from the image's middle.
    """

    views: np.ndarray
    view: np.ndarray
    point: np.ndarray
    positions: np.ndarray
    logs: np.ndarray
    falloff: np.ndarray


def colors_of_points(scene: Scene, seen_by: int) -> PointColors | None:
    """The colours of points that so many of the training photographs see; None: too few of them."""
    train = np.array(scene.train_indices)
    views = train[np.unique(np.linspace(0, len(train) - 1, _MOST_VIEWS).round().astype(int))]
    if len(views) < _FEWEST_VIEWS or not len(scene.points):
        return None
    points = scene.points[:: -(-len(scene.points) // _MOST_POINTS)]
    seen = [_colors(scene, int(view), points) for view in views]
    view = np.repeat(np.arange(len(seen)), [len(rows) for rows, *_ in seen])
    point, colors, radius = (np.concatenate(column) for column in zip(*seen, strict=True))
    often = np.bincount(point, minlength=len(points))[point] >= seen_by
    view, rows = view[often], point[often]
    if np.bincount(view, minlength=len(views)).min() < _FEWEST_SEEN:
        return None
    logs = np.log(np.ascontiguousarray(colors[often].T))
    falloff = radius[often] ** (2 * np.arange(1, _ORDERS + 1)[:, None])
    point = np.unique(rows, return_inverse=True)[1]
    return PointColors(views, view, point, points[rows], logs, falloff)


def gains_of(seen: PointColors) -> tuple[np.ndarray, bool]:
    """Log-gains (V, 3) of the views, of mean zero, and whether they differ for certain."""
    samples = seen.view, seen.point, seen.logs, seen.falloff
    gains, error = _fit(*samples, len(seen.views))
    _, without = _fit(*samples, 0)
    return gains, gains.mean(axis=1).std() >= _DIFFER and error <= _LEFT_OVER * without


def _colors(
    scene: Scene, view: int, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points that a view sees well exposed: rows, colours (n, 3), distances from the middle."""
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


def _fit(
    view: np.ndarray, point: np.ndarray, logs: np.ndarray, falloff: np.ndarray, num_views: int
) -> tuple[np.ndarray, float]:
    """Robust least squares of logs (3, n) = the point's + the view's + falloff (k, n) x its own.

    Points are eliminated: what is fitted is each sample's difference from its point's mean.
    Args:
        view, point: (n,) of each sample.
        logs, falloff: see above.
        num_views: 0: views have nothing of their own.

    Returns:
        (num_views, 3) of mean zero, and the median of the samples' largest errors.
    """
    num_points, weights = int(point.max()) + 1, np.ones(len(view))
    for _ in range(_ROUNDS):
        total = np.bincount(point, weights, num_points)
        right, basis = (_centred(rows, point, weights, total) for rows in (logs, falloff))
        weighted = weights * basis
        normal, side = (np.einsum("in,jn->ij", weighted, rows) for rows in (basis, right))
        if num_views:
            where = np.bincount(point * num_views + view, weights, num_points * num_views)
            where = where.reshape(num_points, num_views)
            shared = _product(where, where / total[:, None])
            both = _sums(view, weighted, num_views)
            normal = np.block([[np.diag(where.sum(axis=0)) - shared, both.T], [both, normal]])
            side = np.concatenate([_sums(view, weights * right, num_views).T, side])
        # Gains have a constant in common that nothing tells: of all solutions the smallest.
        found = np.linalg.lstsq(normal, side, rcond=1e-9)[0]
        errors = right - np.einsum("kc,kn->cn", found[num_views:], basis)
        if num_views:
            errors -= _centred(found[:num_views].T[:, view], point, weights, total)
        largest = np.abs(errors).max(axis=0)
        error = max(float(np.median(largest)), np.finfo(float).eps)
        weights = 1.0 / (1.0 + (largest / (1.4826 * error)) ** 2) ** 2  # Geman and McClure's
    gains = found[:num_views]
    return gains - gains.mean(axis=0) if num_views else gains, error


def _product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(i, j) a'b of (n, i) and (n, j), in parts that BLAS wakes no threads for.

    They would spin longer than they work.
    """
    rows = max(1, _ALONE // (a.shape[1] * b.shape[1]))
    return sum(
        (a[at : at + rows].T @ b[at : at + rows] for at in range(0, len(a), rows)),
        start=np.zeros((a.shape[1], b.shape[1])),
    )


def _centred(
    rows: np.ndarray, point: np.ndarray, weights: np.ndarray, total: np.ndarray
) -> np.ndarray:
    """Samples (k, n) less the weighted mean of all of their point."""
    return rows - (_sums(point, weights * rows, len(total)) / total)[:, point]


def _sums(which: np.ndarray, rows: np.ndarray, count: int) -> np.ndarray:
    """(k, count) sums of samples (k, n) over each of `which` (n,)."""
    return np.stack([np.bincount(which, row, count) for row in rows])
