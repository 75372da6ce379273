"""Compaction: the same picture from fewer Gaussians, by merging or by pruning."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.compact.refit import DAMPING, refit_colors
from gsut.compact.scores import SeenView, blend_weights, lightgaussian_scores, pup_scores
from gsut.gaussians import Gaussians

METHODS = ("ghap", "field", "ghap-paper", "lightgaussian", "pup")
# What the merging methods weigh beside the difference of colours: divergence, drawn fields. On
# training views set aside from models of 200 000 (sponza_fisheye 33.94 dB, fox), PSNR at 10 %:
# 0.01, 0.1: 30.19 and 28.20; 0, 0.1: 30.26 and 28.21.
_MERGING_COSTS = (0.0, 0.1)
_MERGING = ("ghap", "field")
# Of ghap's colours. The same views of sponza at 10 / 20 %: 0 rounds 30.26 / 32.37, 1 30.74 / 32.52,
# 2 30.82 / 32.56, 3 30.86 / 32.58.
_REFIT_ROUNDS = 2
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
    scores: np.ndarray | None = None,
    on_view: Callable[[], object] = lambda: None,
) -> Compaction:
    """Reduces the number of Gaussians; no photograph is used.

    Args:
        gaussians: N Gaussians.
        keep: fraction to keep, above 0 and at most 1 ...
        count: ... or their number, at least 1. Give one of the two.
        method: "ghap": merges pairs of neighbours bottom up where it costs least in colour and
            shape (difference of the drawn fields), weighted by what the views see of them, and
            then fits colours to the whole scene's pictures in these views (`refit_colors`);
            "field": likewise without the second part; "ghap-paper": the publication's k-means;
            "lightgaussian", "pup": pruning by score.
        views: from `seen_views`; lightgaussian and pup need them, ghap and field weigh by opacity
            times size without them, ghap-paper does not look.
        seed: of ghap-paper's start.
        scores: from `scores_of` with the same Gaussians, views and method, so that several numbers
            cost one look; None: they are found.
        on_view: called after each view.

    Returns:
        The reduced Gaussians: round(keep N) of the rows that are finite (ghap-paper: within one a
        block). The same bits on any number of threads.

    Raises:
        InputError: keep, count or method out of range, or no views for a method that needs them.

    Source: "Gaussian Herding across Pens" (GHAP), 2025; LightGaussian, NeurIPS 2024; PUP 3D-GS,
        CVPR 2025.
    """
    check_method(method, bool(views))
    g = _finite(gaussians)
    dropped = len(gaussians) - len(g)
    target = _target(len(g), keep, count)
    if target == len(g):
        return Compaction(g.copy(), dropped)
    if method == "ghap-paper":
        return Compaction(Gaussians(*_core.herd_paper(g, target / len(g), seed=seed)), dropped)
    if scores is None:
        scores = scores_of(g, method, views, on_view)
    if scores is not None and len(scores) != len(g):
        raise InputError(f"scores must be one a finite Gaussian, {len(g)}, found {len(scores)}")
    if method in _MERGING:
        weights = None if scores is None else scores.astype(np.float32)
        merged = Gaussians(*_core.merge_pairs(g, target, weights, *_MERGING_COSTS))
        if method == "ghap" and views:
            merged = refit_colors(merged, g, views, _REFIT_ROUNDS, on_view)
        return Compaction(merged, dropped)
    assert scores is not None  # check_method
    # Stable: among equal scores the first rows stay.
    best = np.argsort(-scores, kind="stable")[:target]
    return Compaction(g[np.sort(best)], dropped)


def scores_of(
    gaussians: Gaussians,
    method: str,
    views: Sequence[SeenView],
    on_view: Callable[[], object] = lambda: None,
) -> np.ndarray | None:
    """What a method asks the views, which does not depend on how many Gaussians are kept.

    Args:
        gaussians, method, views, on_view: as in `compact`.

    Returns:
        A float64 for each Gaussian whose values are finite: blend weights for ghap and field,
        scores for lightgaussian and pup; None for a method that does not look, or without views.
    """
    finders = {"lightgaussian": lightgaussian_scores, "pup": pup_scores}
    if method not in _LOOKING or not views:
        return None
    return finders.get(method, blend_weights)(_finite(gaussians), views, on_view)


def _finite(gaussians: Gaussians) -> Gaussians:
    g = gaussians.astype(np.float32)
    finite = finite_rows(g)
    return g if finite.all() else g[finite]


def looks_at_views(method: str) -> bool:
    """Whether a method makes use of views."""
    return method in _LOOKING


def settings_of(method: str) -> dict[str, Any]:
    """The constants that a method works with here, to tell results of other constants apart."""
    if method not in _MERGING:
        return {"method": method}
    refit = [_REFIT_ROUNDS, DAMPING] if method == "ghap" else []
    return {"method": method, "costs": list(_MERGING_COSTS), "refit": refit}


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
        values = getattr(gaussians, field.name)
        finite &= np.isfinite(values).all(axis=tuple(range(1, values.ndim)))
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
