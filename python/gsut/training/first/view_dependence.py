"""Measures whether the colours of a scene depend on the direction that they are seen from.

Each of the scene's points has a colour in every photograph that sees it. If a plane over the
directions, fitted to all photographs but one, predicts that one better than their mean does,
harmonics of a higher degree show held-out views better, too; otherwise they learn noise.
"""

from __future__ import annotations

import numpy as np

from gsut.data import Scene
from gsut.training.first.gains import fit_gains, sample_points

# Photographs that must see a point: a plane over the directions has four unknowns.
_SEEN_BY = 6
# Fewest points that decide.
_FEWEST_POINTS = 100
# Largest deviation of a colour's logarithm: a larger one shows another surface in front.
_CLIPPED = 0.3
# Weight of the prior that there is no slope, in views.
_RIDGE = 1.0
# Least root mean square of a point's directions about their mean: narrower ones show no slope.
_LEAST_SPREAD = 0.05


def measure_unpredicted_share(scene: Scene) -> float | None:
    """Returns the share of the variance of points' colours that the viewing direction does not
    predict.

    Args:
        scene: as it is trained on; only its training photographs are used.

    Returns:
        Mean square error of each colour's logarithm, predicted from its point's other photographs
        by ridge regression on the direction, over that of their mean; about 1 if colours do not
        depend on the direction, None if there are too few points to decide.
    """
    seen = sample_points(scene, _SEEN_BY)
    if seen is None:
        return None
    gains, are_certain = fit_gains(seen)
    logs = seen.logs - gains[seen.view].T if are_certain else seen.logs
    centers = np.stack([scene.views[index].camera_center for index in seen.views])
    directions = centers[seen.view] - seen.positions
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return _predict_left_out(seen.point, logs.mean(axis=0), directions)


def _predict_left_out(
    point: np.ndarray, colors: np.ndarray, directions: np.ndarray
) -> float | None:
    """Computes the share for colours (n,) and directions (n, 3) of points (n,)."""
    number = np.bincount(point).astype(float)

    def add_by_point(values: np.ndarray) -> np.ndarray:
        return np.bincount(point, values, len(number))

    def subtract_mean(values: np.ndarray) -> np.ndarray:
        return values - (add_by_point(values) / number)[point]

    colors = subtract_mean(np.clip(subtract_mean(colors), -_CLIPPED, _CLIPPED))
    slopes = np.stack([subtract_mean(axis) for axis in directions.T])
    spread = np.sqrt(add_by_point(np.square(slopes).sum(axis=0)) / number)
    decides = spread > _LEAST_SPREAD
    if decides.sum() < _FEWEST_POINTS:
        return None
    slopes /= np.maximum(spread, _LEAST_SPREAD)[point]
    normal = np.stack([[add_by_point(a * b) for b in slopes] for a in slopes]).transpose(2, 0, 1)
    inverse = np.linalg.inv(normal + _RIDGE * np.eye(3))
    right = np.stack([add_by_point(a * colors) for a in slopes], axis=1)
    found = np.einsum("pij,pj->pi", inverse, right)[point]
    # The leverage of a sample, its weight in its own fitted value: a share of the mean and of the
    # slopes. Dividing a residual by 1 - leverage gives the error when the sample is left out.
    leverage = 1.0 / number[point] + np.einsum("in,nij,jn->n", slopes, inverse[point], slopes)
    by_plane = (colors - np.einsum("in,ni->n", slopes, found)) / (1.0 - leverage)
    by_mean = colors / (1.0 - 1.0 / number[point])
    each = [add_by_point(np.square(error)) / number for error in (by_plane, by_mean)]
    return float(each[0][decides].sum() / each[1][decides].sum())
