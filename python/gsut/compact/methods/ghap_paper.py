"""GHAP as it was published: k-means in blocks of the scene, which does not look at views."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from gsut import _core
from gsut.compact.method import Method
from gsut.compact.scores import SeenView
from gsut.gaussians import Gaussians


def _reduce(
    gaussians: Gaussians,
    target: int,
    scores: np.ndarray | None,
    views: Sequence[SeenView],
    seed: int,
    on_view: Callable[[], object],
) -> Gaussians:
    arrays = _core.herd_paper(gaussians, target / len(gaussians), seed=seed)
    return Gaussians(*arrays, response=gaussians.response, order=gaussians.order)


METHOD = Method(_reduce)
