"""The schedule of a run: the view, the learning rates and the number of Gaussians at a step."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gsut.optimize.optimizer import LearningRates
from gsut.run import TrainOptions


def choose_view(views: Sequence[int], step: int, seed: int) -> int:
    """Chooses the view of a step (from 1): each once an epoch, shuffled by seed and epoch."""
    epoch, place = divmod(step - 1, len(views))
    order = np.random.default_rng([seed, epoch]).permutation(len(views))
    return views[order[place]]


def compute_learning_rates(options: TrainOptions, fraction: float, extent: float) -> LearningRates:
    """Computes the rates at a fraction of the steps; all but the centres' fall alike.

    Args:
        options: of the run, from `TrainOptions(...).resolve()`.
        fraction: of the steps, from 0 to 1.
        extent: size of the scene in world units, see `Scene.extent`; scales the centres' rate.

    Returns:
        The rates of one step, for `GaussianOptimizer.step`.
    """
    o = options
    decay = o.lr_final_factor**fraction
    return LearningRates(
        means=o.lr_means * extent * o.lr_means_final_factor**fraction, quats=o.lr_quats * decay,
        log_scales=o.lr_scales * decay, opacity_logits=o.lr_opacity * decay, sh0=o.lr_sh0 * decay,
        sh_rest=o.lr_sh_rest * decay, shapes=o.lr_shapes * decay,
    )  # fmt: skip


def compute_target_size(options: TrainOptions, first: int, fraction: float) -> int:
    """Computes how many Gaussians to have: geometric growth from `first` to `max_gaussians`."""
    o = options
    if fraction >= o.grow_until or first >= o.max_gaussians:
        return o.max_gaussians
    progress = max(0.0, fraction - o.densify_from) / max(1e-9, o.grow_until - o.densify_from)
    return round(first * (o.max_gaussians / first) ** progress)


def find_last_densification(options: TrainOptions) -> int:
    """Returns the last step (from 1) at which densification may be due, or 0."""
    return (
        int(options.densify_until * options.steps) // options.densify_every * options.densify_every
    )
