"""Compaction: the same picture from fewer Gaussians, by merging or by pruning."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.compact_scores import SeenView, blend_weights, lightgaussian_scores, pup_scores
from gsut.gaussians import Gaussians

METHODS = ("ghap", "field", "ghap-paper", "lightgaussian", "pup")
# What each merging method weighs beside the difference of colours: divergence, drawn fields.
# Held-out PSNR of sponza_fisheye merged from 500 000 (35.43 dB) to 20 / 10 %, not fine-tuned:
# 0.05, 0: 33.87 / 31.63; 0, 0.02: 33.81 / 31.75; 0, 0.1: 33.94 / 31.89; 0, 0.5: 33.88 / 31.67;
# 0.01, 0.1: 34.00 / 32.05; 0.03, 0.1: 33.99 / 31.97.
_MERGING = {"ghap": (0.01, 0.1), "field": (0.0, 0.1)}
# Methods that see the Gaussians through the views' lenses, and those that cannot do without.
_LOOKING = ("ghap", "field", "lightgaussian", "pup")
_NEED_VIEWS = ("lightgaussian", "pup")


@dataclasses.dataclass(frozen=True)
class Compaction:
    """What compaction gives.

    Attributes:
        gaussians: float32, in no particular order.
        dropped: rows with values that are not finite, which were left out first.
    """

    gaussians: Gaussians
    dropped: int


def compact(
    gaussians: Gaussians,
    keep: float | None = None,
    *,
    count: int | None = None,
    method: str = "ghap",
    views: Sequence[SeenView] = (),
    seed: int = 0,
    on_view: Callable[[], object] = lambda: None,
) -> Compaction:
    """Reduces the number of Gaussians; no photograph is used.

    Args:
        gaussians: N Gaussians.
        keep: fraction to keep, above 0 and at most 1 ...
        count: ... or their number, at least 1. Give one of the two.
        method: "ghap": merges pairs of neighbours bottom up where it costs least in colour and
            shape (difference of the drawn fields, and divergence of the merged from the two),
            weighted by what the views see of them; "field": likewise without the divergence;
            "ghap-paper": the publication's k-means; "lightgaussian", "pup": pruning by score.
        views: from `seen_views`; lightgaussian and pup need them, ghap and field weigh by opacity
            times size without them, ghap-paper does not look.
        seed: of ghap-paper's start.
        on_view: called after each view.

    Returns:
        The reduced Gaussians: round(keep N) of the rows that are finite (ghap-paper: within one a
        block). The same bits on any number of threads.

    Raises:
        InputError: keep, count or method out of range, or no views for a method that needs them.

    Source: "Gaussian Herding across Pens" (GHAP), 2025; Runnalls, IEEE Trans. AES 2007 (the
        divergence); LightGaussian, NeurIPS 2024; PUP 3D-GS, CVPR 2025.
    """
    check_method(method, bool(views))
    g = gaussians.astype(np.float32)
    finite = finite_rows(g)
    dropped = len(g) - int(np.count_nonzero(finite))
    if dropped:
        g = g[finite]
    target = _target(len(g), keep, count)
    if target == len(g):
        return Compaction(g.copy(), dropped)
    if method == "ghap-paper":
        return Compaction(Gaussians(*_core.herd_paper(g, target / len(g), seed=seed)), dropped)
    if method in _MERGING:
        weights = blend_weights(g, views, on_view).astype(np.float32) if views else None
        merged = _core.merge_pairs(g, target, weights, *_MERGING[method])
        return Compaction(Gaussians(*merged), dropped)
    if method == "lightgaussian":
        scores = lightgaussian_scores(g, views, on_view)
    else:
        scores = pup_scores(g, views, on_view)
    # Stable: among equal scores the first rows stay.
    best = np.argsort(-scores, kind="stable")[:target]
    return Compaction(g[np.sort(best)], dropped)


def looks_at_views(method: str) -> bool:
    """Whether a method makes use of views."""
    return method in _LOOKING


def check_method(method: str, has_views: bool) -> None:
    """Raises InputError for a method that is unknown, or needs views where there are none."""
    if method not in METHODS:
        raise InputError(f'method "{method}" is unknown; known: {", ".join(METHODS)}')
    if method in _NEED_VIEWS and not has_views:
        raise InputError(
            f'method "{method}" scores Gaussians by what views see of them; give the run with its '
            "dataset, or use ghap"
        )


def check_keep(keep: float) -> None:
    """Raises InputError unless 0 < keep <= 1."""
    if not (math.isfinite(keep) and 0.0 < keep <= 1.0):
        raise InputError(
            f"keep must be above 0 and at most 1, found {keep}; 0.1 keeps a tenth of the Gaussians"
        )


def finite_rows(gaussians: Gaussians) -> np.ndarray:
    """(N,) bool: rows all of whose values are finite."""
    finite = np.ones(len(gaussians), bool)
    for field in dataclasses.fields(gaussians):
        values = getattr(gaussians, field.name).reshape(len(gaussians), -1)
        finite &= np.isfinite(values).all(axis=1)
    return finite


def _target(rows: int, keep: float | None, count: int | None) -> int:
    if (keep is None) == (count is None):
        raise InputError("give keep (a fraction) or count (a number of Gaussians), not both")
    if keep is not None:
        check_keep(keep)
        return min(rows, max(1, round(keep * rows)))
    assert count is not None
    if count < 1:
        raise InputError(f"count is {count}; at least one Gaussian must stay")
    return min(rows, count)
