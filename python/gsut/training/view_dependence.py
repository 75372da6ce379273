"""Whether the colours of a scene depend on the direction that they are seen from.

Each of the scene's points has a colour in every photograph that sees it. Where a plane over the
directions, laid through all photographs but one, foretells that one better than their mean does,
harmonics of a higher degree show views that were not trained on better, too; where it does not,
they learn noise (docs/results.md).
"""

from __future__ import annotations

import numpy as np

from gsut.data import Scene
from gsut.training.first_gains import colors_of_points, gains_of

_SEEN_BY = 6  # photographs, or a point says nothing
_FEWEST_POINTS = 100  # that say something, or nothing is said
_CLIPPED = 0.3  # of the logarithm: more is another surface in front
_RIDGE = 1.0  # views that say that there is no slope
_LEAST_SPREAD = 0.05  # root mean square of the directions of a point about their mean


def unforeseen_share(scene: Scene) -> float | None:
    """The part of the variance of points' colours that directions of view do not foretell.

    Args:
        scene: as it is trained on; only its training photographs are looked at.

    Returns:
        Mean square error of each colour's logarithm, foretold from its point's other photographs
        by ridge regression on the direction, over that of the mean of these; about 1 where colours
        do not depend on the direction, and None where there are too few points to tell.
    """
    seen = colors_of_points(scene, _SEEN_BY)
    if seen is None:
        return None
    gains, are_certain = gains_of(seen)
    logs = seen.logs - gains[seen.view].T if are_certain else seen.logs
    centers = np.stack([scene.views[index].camera_center for index in seen.views])
    directions = centers[seen.view] - seen.positions
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return _unforeseen(seen.point, logs.mean(axis=0), directions)


def _unforeseen(point: np.ndarray, colors: np.ndarray, directions: np.ndarray) -> float | None:
    """Of colours (n,) and directions (n, 3) of points (n,); see `unforeseen_share`."""
    number = np.bincount(point).astype(float)

    def sums(values: np.ndarray) -> np.ndarray:
        return np.bincount(point, values, len(number))

    def centred(values: np.ndarray) -> np.ndarray:
        return values - (sums(values) / number)[point]

    colors = centred(np.clip(centred(colors), -_CLIPPED, _CLIPPED))
    slopes = np.stack([centred(axis) for axis in directions.T])
    spread = np.sqrt(sums(np.square(slopes).sum(axis=0)) / number)
    tells = spread > _LEAST_SPREAD
    if tells.sum() < _FEWEST_POINTS:
        return None
    slopes /= np.maximum(spread, _LEAST_SPREAD)[point]
    normal = np.stack([[sums(a * b) for b in slopes] for a in slopes]).transpose(2, 0, 1)
    inverse = np.linalg.inv(normal + _RIDGE * np.eye(3))
    right = np.stack([sums(a * colors) for a in slopes], axis=1)
    found = np.einsum("pij,pj->pi", inverse, right)[point]
    # What a sample weighs in its own value: its share of the mean and of the slopes.
    own = 1.0 / number[point] + np.einsum("in,nij,jn->n", slopes, inverse[point], slopes)
    foretold = (colors - np.einsum("in,ni->n", slopes, found)) / (1.0 - own)
    by_mean = colors / (1.0 - 1.0 / number[point])
    each = [sums(np.square(error)) / number for error in (foretold, by_mean)]
    return float(each[0][tells].sum() / each[1][tells].sum())
