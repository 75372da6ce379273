"""Harmonics only where they are seen: each Gaussian's degree, as low as held-out views allow."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from gsut.compact.scores import SeenView, sum_bases
from gsut.gaussians import Gaussians

# Tries of the search for the highest cost that is not noticed, each halving what is left.
_TRIES = 12


@dataclasses.dataclass(frozen=True)
class Harmonics:
    """Gaussians with fewer harmonics.

    Attributes:
        gaussians: coefficients above a Gaussian's degree are 0; the array is as wide as the highest
            degree in use, so that a scene that needs none also renders faster and is smaller.
        degrees: (N,) uint8.
    """

    gaussians: Gaussians
    degrees: np.ndarray


def drop_harmonics(
    gaussians: Gaussians,
    views: Sequence[SeenView],
    measure: Callable[[Gaussians], float],
    max_drop: float,
    on_view: Callable[[], object] = lambda: None,
) -> Harmonics:
    """Lowers each Gaussian's degree where that costs least, as far as a measure allows.

    What a degree's loss costs is the blend weight that the views see of the Gaussian times the
    mean square of the colours of the degrees that go. The mean of these colours over the directions
    from which the views see the Gaussian goes into its base colour.

    Args:
        gaussians: N Gaussians.
        views: through which the Gaussians are seen, at least one.
        measure: PSNR in dB of such Gaussians, on views that are held out.
        max_drop: dB that may be lost against `gaussians`.
        on_view: called after each view.

    Returns:
        Gaussians and degrees; measure(result) >= measure(gaussians) - max_drop. With harmonics of
        degree 0 the Gaussians as they are.
    """
    n, top = len(gaussians), gaussians.sh_degree
    if top == 0 or n == 0:
        return Harmonics(gaussians, np.zeros(n, np.uint8))
    sums = sum_bases(gaussians, views, on_view)  # (N, K)
    costs = _estimate_costs(gaussians, sums)
    wanted = measure(gaussians) - max_drop
    # Every cost at which some Gaussian's degree changes, from the least.
    steps = np.unique(costs[costs > 0])
    low, high = -1, len(steps)  # steps[low] holds the measure, steps[high] does not
    best = _choose_degrees(gaussians, sums, costs, 0.0)
    for _ in range(_TRIES):
        if high - low <= 1:
            break
        middle = (low + high) // 2
        tried = _choose_degrees(gaussians, sums, costs, float(steps[middle]))
        if measure(tried.gaussians) >= wanted:
            low, best = middle, tried
        else:
            high = middle
    return best


def _estimate_costs(gaussians: Gaussians, sums: np.ndarray) -> np.ndarray:
    """Estimates the cost (N, D) of lowering to degree 0 .. D - 1; it falls along the row."""
    weights = np.maximum(sums[:, 0], 0.0)
    squares = np.sum(gaussians.sh.astype(np.float64) ** 2, axis=2)  # (N, K)
    top = gaussians.sh_degree
    bands = [squares[:, d * d : (d + 1) ** 2].sum(axis=1) for d in range(1, top + 1)]
    above = np.cumsum(np.stack(bands[::-1], axis=1), axis=1)[:, ::-1]
    return weights[:, None] * above


def _choose_degrees(
    gaussians: Gaussians, sums: np.ndarray, costs: np.ndarray, most: float
) -> Harmonics:
    """Chooses the lowest degrees that cost at most `most` each."""
    top = gaussians.sh_degree
    degrees = np.sum(costs > most, axis=1)
    coefficient_degree = np.floor(np.sqrt(np.arange((top + 1) ** 2))).astype(int)
    dropped = coefficient_degree[None, :] > degrees[:, None]  # (N, K)
    sh = gaussians.sh.astype(np.float64)
    seen = sums[:, 0] > 0
    shares = np.where(dropped & seen[:, None], sums, 0.0) / np.where(seen, sums[:, 0], 1.0)[:, None]
    sh[:, 0] += np.einsum("nk,nkc->nc", shares, sh)
    sh[dropped] = 0.0
    used = int(degrees.max(initial=0))
    lowered = dataclasses.replace(
        gaussians, sh=np.ascontiguousarray(sh[:, : (used + 1) ** 2], dtype=gaussians.dtype)
    )
    return Harmonics(lowered, degrees.astype(np.uint8))
