"""PUP 3D-GS: pruning by how much a Gaussian's place and size matter to the picture."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from gsut.compact.method import Method, keep_best
from gsut.compact.scores import Passes, SeenView, require_views
from gsut.gaussians import Gaussians

_PARAMETERS = 6  # position and scale
_UPPER = np.triu_indices(_PARAMETERS)
# Added to the diagonal of a Fisher matrix, of its trace: what few pixels saw has no full rank.
_FISHER_RIDGE = 1e-9


def sum_fisher_matrices(
    gaussians: Gaussians,
    views: Sequence[SeenView],
    on_view: Callable[[], object] = lambda: None,
) -> np.ndarray:
    """Sums each Gaussian's Fisher matrix J J^T over its position and scales.

    Returns:
        (N, 6, 6) float64: the sum over valid pixels of all views and their channels, J being the
        channel's derivative to the mean (world axes) and the three scales (world units). Twice it
        is the Hessian of the squared error where the error itself is 0.
    """
    sums = np.zeros((len(gaussians), _UPPER[0].size))
    passes = Passes(gaussians)
    for view in require_views(views):
        passes.render(view)
        passes.add_fisher(view.mask, sums)
        on_view()
    fisher = np.zeros((len(gaussians), _PARAMETERS, _PARAMETERS))
    fisher[:, _UPPER[0], _UPPER[1]] = sums
    fisher[:, _UPPER[1], _UPPER[0]] = sums
    return fisher


def score_sensitivity(
    gaussians: Gaussians,
    views: Sequence[SeenView],
    on_view: Callable[[], object] = lambda: None,
) -> np.ndarray:
    """Scores PUP-3DGS' sensitivity: log det of the Fisher matrix over position and scale.

    Returns:
        (N,) float64; the lowest are pruned; -inf for what no pixel sees.

    Source: Hanson et al., "PUP 3D-GS", CVPR 2025.
    """
    fisher = sum_fisher_matrices(gaussians, views, on_view)
    trace = np.trace(fisher, axis1=1, axis2=2)
    scores = np.full(len(gaussians), -np.inf)
    seen = np.flatnonzero(trace > 0)
    scaled = fisher[seen] / trace[seen, None, None] + _FISHER_RIDGE * np.eye(_PARAMETERS)
    scores[seen] = np.linalg.slogdet(scaled)[1] + _PARAMETERS * np.log(trace[seen])
    return scores


METHOD = Method(keep_best, score_sensitivity, needs_views=True, only_chooses=True)
