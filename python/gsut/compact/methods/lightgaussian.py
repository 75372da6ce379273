"""LightGaussian: pruning by how many pixels each Gaussian is drawn in, and its volume."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from gsut.compact.method import Method, keep_best
from gsut.compact.scores import Passes, SeenView, paint_grey, require_views
from gsut.gaussians import Gaussians

# Volumes count by (V / V of the 90th percentile) to this power, at most 1 before it.
_VOLUME_POWER = 0.1
_VOLUME_PERCENTILE = 90.0


def sum_hits(
    gaussians: Gaussians,
    views: Sequence[SeenView],
    on_view: Callable[[], object] = lambda: None,
) -> np.ndarray:
    """Sums opacity times transmittance in front over all valid pixels that draw a Gaussian.

    Returns:
        (N,) float64, in pixels; 0 for what no valid pixel sees.
    """
    sums = np.zeros(len(gaussians))
    passes = Passes(paint_grey(gaussians))
    for view in require_views(views):
        passes.render(view)
        passes.add_significance(view.mask, sums)
        on_view()
    return sums


def score_significance(
    gaussians: Gaussians,
    views: Sequence[SeenView],
    on_view: Callable[[], object] = lambda: None,
) -> np.ndarray:
    """Scores LightGaussian's global significance: `sum_hits` times (V / V_90%)^0.1.

    Returns:
        (N,) float64 >= 0; the lowest are pruned.

    Source: Fan et al., "LightGaussian", NeurIPS 2024.
    """
    log_volume = gaussians.log_scales.astype(np.float64).sum(axis=1)
    if len(log_volume) == 0:
        return log_volume
    volume = np.exp(log_volume - log_volume.max())  # in units of the largest
    relative = np.minimum(volume / np.percentile(volume, _VOLUME_PERCENTILE), 1.0)
    return sum_hits(gaussians, views, on_view) * relative**_VOLUME_POWER


METHOD = Method(keep_best, score_significance, needs_views=True, only_chooses=True)
