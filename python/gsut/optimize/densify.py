"""Adds and removes Gaussians together with their Adam moments: MCMC and adaptive control."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from gsut import _core
from gsut.bounds import name_wrong_kinds
from gsut.optimize.optimizer import GaussianOptimizer, allow_one_thread

# Actions of an adaptive plan, as the core numbers them.
_PRUNE = 1
_SPLIT = 3
_LARGEST_LOGIT = 80.0  # exp of it still fits float32


class McmcCounts(NamedTuple):
    """Numbers of Gaussians after `densify_mcmc`, and of those it relocated and added."""

    size: int
    relocated: int
    added: int


class AdaptiveCounts(NamedTuple):
    """Numbers of Gaussians after `densify_adaptive`, and of those it pruned, cloned and split."""

    size: int
    pruned: int
    cloned: int
    split: int


@name_wrong_kinds
@allow_one_thread
def densify_mcmc(
    optimizer: GaussianOptimizer,
    target_size: int,
    weights: np.ndarray | None = None,
    *,
    dead_opacity: float = 0.005,
) -> McmcCounts:
    """Relocates dead Gaussians onto living ones and adds new ones the same way.

    The paper puts n copies of a Gaussian at the same place; here they are spread over its volume:
    scales times n^(-1/3), opacities 1 - (1 - o)^(n^(-1/3)), which keeps the optical thickness.

    Args:
        optimizer: changed.
        target_size: Gaussians to have afterwards; if there are more already, none is added.
        weights: (N,) chances of living Gaussians to be copied. None: opacity x `gradient_max`, or
            if errors were measured, opacity x the root of `gradient_max` x `error_sum`; gradients
            alone miss errors that moving a Gaussian does not reduce.
        dead_opacity: a Gaussian is dead at or below it, or if one of its values is not finite.

    Returns:
        The counts. Fewer are relocated or added if that would copy a living one over 50 times.

    Source: Kheradmand et al., "3D Gaussian splatting as Markov chain Monte Carlo", 2024.
    """
    if weights is None:
        logits = np.clip(optimizer.gaussians.opacity_logits, -_LARGEST_LOGIT, _LARGEST_LOGIT)
        pull, errors = optimizer.gradient_max, optimizer.error_sum
        weights = (np.sqrt(pull * errors) if errors.any() else pull) / (1.0 + np.exp(-logits))
    optimizer.reserve(target_size)
    counts = _core.mcmc_densify(
        *optimizer.arrays, optimizer.size, target_size, np.ascontiguousarray(weights, np.float32),
        dead_opacity, optimizer.seed, optimizer.steps,
    )  # fmt: skip
    optimizer.resize(counts[0])
    return McmcCounts(*counts)


@name_wrong_kinds
@allow_one_thread
def densify_adaptive(
    optimizer: GaussianOptimizer,
    *,
    clone_scale: float,
    gradient_threshold: float = 2e-4,
    prune_opacity: float = 0.005,
    max_scale: float = np.inf,
    max_gaussians: int | None = None,
) -> AdaptiveCounts:
    """Clones or splits Gaussians with large gradients, prunes transparent and huge ones.

    Args:
        optimizer: changed.
        clone_scale: world units; larger Gaussians are split in two with scales / 1.6, smaller
            ones copied. 3DGS: 0.01 x extent of the scene.
        gradient_threshold: of the mean |dL/dmean| x distance / 2 over the views that saw it.
        prune_opacity: below it a Gaussian is pruned.
        max_scale: world units; above it a Gaussian is pruned. 3DGS: 0.1 x extent.
        max_gaussians: if there would be more, only the largest gradients are cloned or split.

    Returns:
        The counts.

    Source: Kerbl et al., "3D Gaussian splatting for real-time radiance field rendering", 2023.
    """
    plan = _core.plan_adaptive(
        optimizer.arrays[0], optimizer.size, optimizer.gradient_sum, optimizer.seen,
        gradient_threshold, clone_scale, prune_opacity, max_scale,
        0 if max_gaussians is None else max_gaussians,
    )  # fmt: skip
    return _apply(optimizer, plan)


@allow_one_thread
def split_and_prune(
    optimizer: GaussianOptimizer, split: np.ndarray, prune: np.ndarray
) -> AdaptiveCounts:
    """Splits chosen Gaussians in two, as `densify_adaptive` does, and prunes others.

    Args:
        optimizer: changed.
        split: (N,) bool.
        prune: (N,) bool; takes precedence over `split`. The others keep their order.
    """
    actions = np.where(prune, _PRUNE, np.where(split, _SPLIT, 0)).astype(np.uint8)
    return _apply(optimizer, _core.AdaptivePlan(actions))


def _apply(optimizer: GaussianOptimizer, plan: Any) -> AdaptiveCounts:
    optimizer.reserve(plan.size_after)
    size = _core.apply_adaptive(
        *optimizer.arrays, optimizer.size, plan, optimizer.seed, optimizer.steps
    )
    optimizer.resize(size)
    return AdaptiveCounts(size, plan.pruned, plan.cloned, plan.split)
