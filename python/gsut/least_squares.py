"""Levenberg-Marquardt, the only one of the Python side: one problem, or many small ones at once."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

# Rounds of reweighting, or of steps that need no damping: both have settled by then.
ROUNDS = 6
LEAST_GAIN = 1e-9  # relative decrease of the cost in a step below which a fit has converged
# First damping, relative to the diagonal of the normal equations: close to a Gauss-Newton step.
_FIRST = 1e-4
# Factors by which the damping falls after a better step and rises after a worse one. They differ,
# since with one factor for both it swings between two values in a curved valley.
_FALL = 3.0
_RISE = 2.0
# Range of the damping: below, the equations are undamped in double; above, steps have no length.
_LEAST = 1e-15
_MOST = 1e8
_SMALLEST_COLUMN = 1e-12  # length of a Jacobian's column below which an unknown is taken to be idle


def minimize_least_squares(
    start: np.ndarray,
    cost_of: Callable[[np.ndarray], Any],
    normal_equations: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
    *,
    max_steps: int,
    least_gain: float = 0.0,
    enough: float = 0.0,
    rise: float = _RISE,
    most_damping: float = _MOST,
    apply: Callable[[np.ndarray, np.ndarray], np.ndarray] = np.add,
) -> tuple[np.ndarray, np.ndarray]:
    """Minimizes a sum of squares by damped Gauss-Newton steps, each of which lowers the cost.

    Args:
        start: (K,) unknowns, where to begin. For P problems that do not depend on each other
            (P, K); each has its own damping.
        cost_of: the sum of squares, one number (or (P,)); infinite where there is none.
        normal_equations: J^T r (K,) and J^T J (K, K), r the residuals and J their derivative to the
            unknowns; (P, K) and (P, K, K) for P problems.
        max_steps: how often the normal equations are formed, at most.
        least_gain: ends where a step lowers the cost by no more than this share of it.
        enough: ends where no cost is above this.
        rise: factor by which the damping rises after a worse step: more where costs are dear.
        most_damping: ends where no step of this damping lowers a cost.
        apply: unknowns and a step to the unknowns after it, where these are not their sum: poses.

    Returns:
        The unknowns with the least cost that was found, and the cost.

    Source: Marquardt, "An algorithm for least-squares estimation of nonlinear parameters", 1963.
    """
    at, cost = start, np.asarray(cost_of(start))
    damping = np.full(cost.shape, _FIRST)
    for _ in range(max_steps):
        gradient, normal = normal_equations(at)
        diagonal = np.einsum("...kk->...k", normal)
        scale = 1.0 / np.maximum(np.sqrt(diagonal), _SMALLEST_COLUMN)
        scaled = normal * scale[..., :, None] * scale[..., None, :]
        while True:
            damped = scaled + damping[..., None, None] * np.eye(normal.shape[-1])
            step = -scale * np.linalg.solve(damped, (scale * gradient)[..., None])[..., 0]
            trial = apply(at, step)
            trial_cost = np.asarray(cost_of(trial))
            better = trial_cost < cost
            eased = np.maximum(damping / _FALL, _LEAST)
            damping = np.where(better, eased, damping * rise)
            if better.any() or (damping > most_damping).all():
                break
        if not better.any():
            break
        done = not (trial_cost < (1.0 - least_gain) * cost).any()
        at = np.where(better[..., None], trial, at)
        cost = np.where(better, trial_cost, cost)
        if done or (cost <= enough).all():
            break
    return at, cost
