"""Compaction: a near picture from fewer Gaussians, by merging or by pruning."""

from __future__ import annotations

import dataclasses
import numbers
from collections.abc import Callable, Sequence

import numpy as np

from gsut._core import InputError
from gsut.bounds import check_number, name_wrong_kinds, show
from gsut.compact.method import METHODS, find_method
from gsut.compact.scores import SeenView
from gsut.gaussians import Gaussians
from gsut.render import place_about


@dataclasses.dataclass(frozen=True)
class Compaction:
    """The result of `compact`.

    Attributes:
        gaussians: float32, in no particular order.
        dropped: rows with values that are not finite, which were left out first.
    """

    gaussians: Gaussians
    dropped: int


@name_wrong_kinds
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
        views: from `list_seen_views`; lightgaussian and pup need them, ghap and field weigh by
            opacity times size without them, ghap-paper does not use them.
        seed: of ghap-paper's start.
        scores: from `score_gaussians` with the same Gaussians, views and method, so that several
            numbers cost one pass over the views; None: they are computed.
        on_view: called after each view.

    Returns:
        The reduced Gaussians, of surfels surfels: round(keep N) of the rows that are finite
        (ghap-paper: within one a block). The same bits on any number of threads.

    Raises:
        InputError: keep, count or method out of range, or no views for a method that needs them.

    Source: "Gaussian Herding across Pens" (GHAP), 2025; LightGaussian, NeurIPS 2024; PUP 3D-GS,
        CVPR 2025.
    """
    check_method(method, bool(views))
    check_primitive(gaussians, method)
    seed = check_number(seed, "seed", 0, whole=True)
    origin = gaussians.origin
    g, views = _keep_finite(gaussians).translate(-origin), _place_views(views, origin)
    dropped = len(gaussians) - len(g)
    target = _count_target(len(g), keep, count)
    if target == len(g):
        return Compaction(g.copy().translate(origin), dropped)
    if scores is None:
        scores = score_gaussians(g, method, views, on_view)
    if scores is not None and len(scores) != len(g):
        raise InputError(f"scores must be one a finite Gaussian, {len(g)}, found {len(scores)}")
    reduced = find_method(method).reduce(g, target, scores, views, seed, on_view)
    if g.are_surfels:
        reduced = reduced.to_surfels()
    return Compaction(reduced.translate(origin), dropped)


def score_gaussians(
    gaussians: Gaussians,
    method: str,
    views: Sequence[SeenView],
    on_view: Callable[[], object] = lambda: None,
) -> np.ndarray | None:
    """Scores Gaussians by a method's look through the views, whatever number is kept.

    Args:
        gaussians, method, views, on_view: as in `compact`.

    Returns:
        A float64 for each Gaussian whose values are finite: blend weights for ghap and field,
        scores for lightgaussian and pup; None for a method that does not look, or without views.
    """
    score = find_method(method).score
    if score is None or not views:
        return None
    g, origin = _keep_finite(gaussians), gaussians.origin
    return score(g.translate(-origin), _place_views(views, origin), on_view)


def _place_views(views: Sequence[SeenView], origin: np.ndarray) -> Sequence[SeenView]:
    """Places the views in coordinates whose zero lies at `origin` (3,)."""
    if not origin.any():
        return views
    return [
        dataclasses.replace(view, camera_from_world=place_about(view.camera_from_world, origin))
        for view in views
    ]


def _keep_finite(gaussians: Gaussians) -> Gaussians:
    g = gaussians.to_dtype(np.float32)
    finite = find_finite_rows(g)
    return g if finite.all() else g[finite]


def needs_views(method: str) -> bool:
    """Returns whether a method uses views."""
    return find_method(method).score is not None


def check_method(method: str, has_views: bool) -> None:
    """Raises InputError for a method that is unknown, or needs views where there are none."""
    if find_method(method).needs_views and not has_views:
        raise InputError(
            f'method "{method}" scores Gaussians by what views see of them; give the run with its '
            "dataset, or use ghap"
        )


def check_primitive(gaussians: Gaussians, method: str) -> None:
    """Raises InputError for a method that merges Gaussians and is given other primitives."""
    if gaussians.primitive == Gaussians.PRIMITIVES[0] or find_method(method).only_chooses:
        return
    choosing = ", ".join(name for name in METHODS if find_method(name).only_chooses)
    raise InputError(
        f'method "{method}" merges Gaussians by their integrals, which primitive '
        f"{gaussians.primitive} does not have; choose among them by {choosing}, or fit Gaussians "
        "first: gsut convert --for viewers"
    )


def check_keep(keep: float) -> None:
    """Raises InputError unless 0 < keep <= 1."""
    if not isinstance(keep, numbers.Real) or not 0.0 < keep <= 1.0:
        raise InputError(
            f"keep must be above 0 and at most 1, found {show(keep)}; 0.1 keeps a tenth of the "
            "Gaussians"
        )


def find_finite_rows(gaussians: Gaussians) -> np.ndarray:
    """Finds rows (N,) all of whose values are finite."""
    finite = np.ones(len(gaussians), bool)
    for field in dataclasses.fields(gaussians):
        values = getattr(gaussians, field.name)
        finite &= np.isfinite(values).all(axis=tuple(range(1, values.ndim)))
    return finite


def _count_target(rows: int, keep: float | None, count: int | None) -> int:
    if (keep is None) == (count is None):
        raise InputError("give keep (a fraction) or count (a number of Gaussians), not both")
    if keep is not None:
        check_keep(keep)
        return min(rows, max(1, round(keep * rows)))
    number = check_number(count, "count", whole=True)
    if number < 1:
        raise InputError(f"count is {number}; at least one Gaussian must stay")
    return min(rows, number)
