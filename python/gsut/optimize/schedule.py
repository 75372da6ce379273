"""What the options ask for at a step: the view, the learning rates, the number of Gaussians."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gsut.optimize.optimizer import LearningRates
from gsut.run import TrainOptions


def view_of_step(views: Sequence[int], step: int, seed: int) -> int:
    """Every view once an epoch, in an order that depends on seed and epoch only; step from 1."""
    epoch, place = divmod(step - 1, len(views))
    order = np.random.default_rng([seed, epoch]).permutation(len(views))
    return views[order[place]]


def learning_rates(options: TrainOptions, fraction: float, extent: float) -> LearningRates:
    """Rates at a fraction of the steps; all but the centres' fall by the same factor.

    Args:
        options: of the run, from `TrainOptions(...).resolved()`.
        fraction: of the steps, from 0 to 1.
        extent: of the scene, world units; see `Scene.extent`.

    Returns:
        The rates of one step, for `GaussianOptimizer.step`.
    """
    o = options
    decay = o.lr_final_factor**fraction
    return LearningRates(
        means=o.lr_means * extent * o.lr_means_final_factor**fraction, quats=o.lr_quats * decay,
        log_scales=o.lr_scales * decay, opacity_logits=o.lr_opacity * decay, sh0=o.lr_sh0 * decay,
        sh_rest=o.lr_sh_rest * decay,
    )  # fmt: skip


def grown_count(options: TrainOptions, first: int, fraction: float) -> int:
    """Geometric growth from the first count to the cap between two fractions of the steps."""
    o = options
    if fraction >= o.grow_until or first >= o.max_gaussians:
        return o.max_gaussians
    begun = max(0.0, fraction - o.densify_from) / max(1e-9, o.grow_until - o.densify_from)
    return round(first * (o.max_gaussians / first) ** begun)


def last_densification(options: TrainOptions) -> int:
    """The last step, from 1, at which densification may be due; 0: none is."""
    return (
        int(options.densify_until * options.steps) // options.densify_every * options.densify_every
    )
