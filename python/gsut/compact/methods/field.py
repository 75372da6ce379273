"""Pairs of neighbours are merged bottom up where it costs least in colour and shape."""

from __future__ import annotations

from typing import Any

import numpy as np

from gsut import _core
from gsut.compact.method import Method
from gsut.compact.scores import blend_weights
from gsut.gaussians import Gaussians


def merge(gaussians: Gaussians, target: int, scores: np.ndarray | None, *_: Any) -> Gaussians:
    """Merges Gaussians to `target`, weighted by scores, or by opacity times size without them."""
    weights = None if scores is None else scores.astype(np.float32)
    arrays = _core.merge_pairs(gaussians, target, weights)
    return Gaussians(*arrays, response=gaussians.response, order=gaussians.order)


METHOD = Method(merge, blend_weights)
