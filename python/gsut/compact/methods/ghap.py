"""Merging as `field`, and then colours fitted to the whole scene's pictures in the views."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from gsut.compact.method import Method
from gsut.compact.methods.field import merge
from gsut.compact.refit import refit_colors
from gsut.compact.scores import SeenView, blend_weights
from gsut.gaussians import Gaussians


def _reduce(
    gaussians: Gaussians,
    target: int,
    scores: np.ndarray | None,
    views: Sequence[SeenView],
    seed: int,
    on_view: Callable[[], object],
) -> Gaussians:
    merged = merge(gaussians, target, scores)
    return refit_colors(merged, gaussians, views, on_view=on_view) if views else merged


METHOD = Method(_reduce, blend_weights)
