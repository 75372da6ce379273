"""The schedule of a run: the view, the learning rates and the number of Gaussians at a step."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gsut.bounds import name_wrong_kinds
from gsut.optimize.optimizer import LearningRates
from gsut.run.options import Recipe

# Fractions of the steps between which Gaussians are added, removed and relocated.
DENSIFY_FROM = 0.05
DENSIFY_UNTIL = 0.8
# Fraction of the steps until which the number of Gaussians grows; the rest refines them.
_GROW_UNTIL = 0.5


def choose_view(views: Sequence[int], step: int, seed: int) -> int:
    """Chooses the view of a step (from 1): each once an epoch, shuffled by seed and epoch."""
    epoch, place = divmod(step - 1, len(views))
    order = np.random.default_rng([seed, epoch]).permutation(len(views))
    return views[order[place]]


@name_wrong_kinds
def compute_learning_rates(recipe: Recipe, fraction: float, extent: float) -> LearningRates:
    """Computes the rates at a fraction of the steps; all but the centres' fall alike.

    Args:
        recipe: of the run, such as `TrainOptions().recipe`.
        fraction: of the steps, from 0 to 1.
        extent: size of the scene in world units, see `Scene.extent`; scales the centres' rate.

    Returns:
        The rates of one step, for `GaussianOptimizer.step`.
    """
    r, decay = recipe, recipe.lr_final_factor**fraction
    return LearningRates(
        means=r.lr_means * extent * r.lr_means_final_factor**fraction, quats=r.lr_quats * decay,
        log_scales=r.lr_scales * decay, opacity_logits=r.lr_opacity * decay, sh0=r.lr_sh0 * decay,
        sh_rest=r.lr_sh_rest * decay,
    )  # fmt: skip


def compute_target_size(most: int, first: int, fraction: float, overgrowth: float = 1.0) -> int:
    """Computes how many Gaussians to have at a fraction of the steps.

    The number grows geometrically from `first` to `overgrowth` x `most`; then it is `most`.
    """
    peak = overgrowth * most
    if fraction >= _GROW_UNTIL or first >= peak:
        return most
    progress = max(0.0, fraction - DENSIFY_FROM) / (_GROW_UNTIL - DENSIFY_FROM)
    return round(first * (peak / first) ** progress)


def find_last_densification(recipe: Recipe, steps: int) -> int:
    """Returns the last step (from 1) at which densification may be due, or 0."""
    return int(DENSIFY_UNTIL * steps) // recipe.densify_every * recipe.densify_every
