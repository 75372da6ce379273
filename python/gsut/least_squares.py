"""Levenberg-Marquardt, the only one of the Python side: one problem, or many small ones at once."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

# Of the damping, relative to the diagonal of the normal equations.
_FACTOR, _LEAST_DAMPING = 10.0, 1e-15
_SMALLEST_COLUMN = 1e-12  # length of a Jacobian's column below which an unknown is taken to be idle


def minimize_least_squares(
    start: Any,
    cost_of: Callable[[Any], Any],
    normal_equations: Callable[[Any], tuple[np.ndarray, np.ndarray]],
    move: Callable[[Any, np.ndarray], Any] = lambda state, step: state + step,
    *,
    max_steps: int,
    first_damping: float = 1e-4,
    most_damping: float = 1e8,
    least_gain: float = 0.0,
) -> tuple[Any, Any]:
    """Minimizes a sum of squares by damped Gauss-Newton steps, each of which lowers the cost.

    Args:
        start: where to begin: an array (K,) of unknowns, or anything that `move` understands. For
            P problems that do not depend on each other an array (P, K); each has its own damping.
        cost_of: the sum of squares of a state, one number (or (P,)); infinite where it has none.
        normal_equations: J^T r (K,) and J^T J (K, K) of a state, r the residuals and J their
            derivative to a step; (P, K) and (P, K, K) for P problems.
        move: the state after a step (K,).
        max_steps: how often the normal equations are formed, at most.
        first_damping: at the start; it falls and rises by factors of ten.
        most_damping: beyond it no smaller step is tried.
        least_gain: ends where a step lowers the cost by no more than this share of it.

    Returns:
        The state with the least cost that was found, and the cost.

    Source: Marquardt, "An algorithm for least-squares estimation of nonlinear parameters", 1963.
    """
    state, cost = start, np.asarray(cost_of(start))
    damping = np.full(cost.shape, first_damping)
    for _ in range(max_steps):
        gradient, normal = normal_equations(state)
        diagonal = np.einsum("...kk->...k", normal)
        scale = 1.0 / np.maximum(np.sqrt(diagonal), _SMALLEST_COLUMN)
        scaled = normal * scale[..., :, None] * scale[..., None, :]
        while True:
            damped = scaled + damping[..., None, None] * np.eye(normal.shape[-1])
            step = -scale * np.linalg.solve(damped, (scale * gradient)[..., None])[..., 0]
            trial = move(state, step)
            trial_cost = np.asarray(cost_of(trial))
            better = trial_cost < cost
            damping = np.where(
                better, np.maximum(damping / _FACTOR, _LEAST_DAMPING), damping * _FACTOR
            )
            if better.any() or (damping > most_damping).all():
                break
        if not better.any():
            break
        done = not (trial_cost < (1.0 - least_gain) * cost).any()
        state = np.where(better[:, None], trial, state) if better.ndim else trial
        cost = np.where(better, trial_cost, cost)
        if done:
            break
    return state, cost
