"""Mini-Splatting's densification: blur split, depth re-initialisation, importance sampling."""

from __future__ import annotations

import math

import numpy as np

from gsut.compact import blend_weights, find_strongest, list_seen_views
from gsut.data import Scene
from gsut.gaussians import Gaussians, seed_from_points
from gsut.optimize import GaussianOptimizer, densify_adaptive, split_and_prune
from gsut.run import TrainOptions
from gsut.training.densification import Densification, DensificationStep

# Fraction of a view's valid pixels at which a Gaussian is the strongest that counts as blurred
# (publication).
BLUR_FRACTION = 2e-4
# Size below which a Gaussian is cloned, above which it is split, x scene extent (3DGS).
_CLONE_SCALE = 0.01
# Views that are searched for blurred Gaussians at each densification, drawn anew.
_BLUR_VIEWS = 8
# Fraction of the steps at which new Gaussians replace the old, at the depths seen (publication).
REINIT_AT = 0.25
# Fraction of the steps at which growth ends and Gaussians are sampled (publication).
SAMPLE_AT = 0.5
# Most Gaussians before sampling, x --max-gaussians: enough to sample the important ones from.
OVERGROWN = 3


def find_blurred(gaussians: Gaussians, scene: Scene, indices: list[int]) -> np.ndarray:
    """Finds Gaussians that are the strongest at more than `BLUR_FRACTION` of some view's pixels.

    Args:
        gaussians: N Gaussians.
        scene: at the resolution to render.
        indices: of the views.

    Returns:
        (N,) bool.
    """
    found = np.zeros(len(gaussians), bool)
    for view in list_seen_views(scene, indices):
        winner, _ = find_strongest(gaussians, view)
        counts = np.bincount(winner[winner >= 0], minlength=len(gaussians))
        found |= counts > max(1.0, BLUR_FRACTION * np.count_nonzero(view.mask))
    return found


def reinitialize(
    gaussians: Gaussians, scene: Scene, options: TrainOptions, count: int, seed: list[int]
) -> Gaussians:
    """Seeds new Gaussians on the surfaces that the training views see, in the photographs' colours.

    Args:
        gaussians: which show the surfaces: the point of each pixel's ray nearest to the centre of
            the pixel's strongest Gaussian.
        scene: at the resolution to render.
        options: shape and harmonics of first Gaussians.
        count: how many, spread evenly over the views; fewer if there are not enough pixels.
        seed: of the choice of pixels.
    """
    rng, views = np.random.default_rng(seed), scene.train_indices
    points, colors = [], []
    for number, index in enumerate(views):
        share = (number + 1) * count // len(views) - number * count // len(views)
        winner, point = find_strongest(gaussians, list_seen_views(scene, [index])[0])
        pixels = np.flatnonzero(winner >= 0)
        pixels = np.sort(rng.choice(pixels, min(share, len(pixels)), replace=False))
        points.append(point.reshape(-1, 3)[pixels])
        colors.append(scene.image(index).reshape(-1, 3)[pixels])
    return seed_from_points(
        np.concatenate(points), np.concatenate(colors), sh_degree=options.sh_degree,
        seed=options.seed,
    )  # fmt: skip


def sample(gaussians: Gaussians, scene: Scene, count: int, seed: list[int]) -> np.ndarray:
    """Draws the Gaussians that stay, in proportion to their blend weights.

    Only those that are the strongest somewhere can be drawn (intersection preserving).

    Args:
        gaussians: N Gaussians.
        scene: at the resolution to render, through all its training views.
        count: the most to draw.
        seed: of the draw.

    Returns:
        (N,) bool.
    """
    views = list_seen_views(scene, scene.train_indices)
    strong = np.zeros(len(gaussians), bool)
    for view in views:
        winner, _ = find_strongest(gaussians, view)
        strong[winner[winner >= 0]] = True
    weights = np.where(strong, blend_weights(gaussians, views), 0.0)
    candidates = np.flatnonzero(weights > 0)
    if len(candidates) > count:
        chances = weights[candidates] / weights[candidates].sum()
        rng = np.random.default_rng(seed)
        candidates = rng.choice(candidates, count, replace=False, p=chances)
    kept = np.zeros(len(gaussians), bool)
    kept[candidates] = True
    return kept


class Strategy(Densification):
    """Fang and Wang, "Mini-Splatting", ECCV 2024; `max_gaussians` is what sampling leaves."""

    def densify(self, optimizer: GaussianOptimizer, now: DensificationStep) -> GaussianOptimizer:
        """Clones and splits by gradient and blur; re-initialises and samples once each."""
        o, step, scene = self.options, now.step, now.scene
        seed = [o.seed, step]
        if self._is_due(SAMPLE_AT, step):
            kept = sample(optimizer.gaussians, scene, o.max_gaussians, seed)
            split_and_prune(optimizer, np.zeros(len(kept), bool), ~kept)
            return optimizer
        if step >= SAMPLE_AT * o.steps:
            return optimizer
        if self._is_due(REINIT_AT, step):
            new = reinitialize(optimizer.gaussians, scene, o, optimizer.size, seed)
            return optimizer.restart_with(new)
        most = OVERGROWN * o.max_gaussians
        densify_adaptive(
            optimizer,
            clone_scale=_CLONE_SCALE * now.extent,
            max_gaussians=most,
        )
        views = scene.train_indices
        chosen = np.random.default_rng(seed).permutation(len(views))[:_BLUR_VIEWS]
        split = find_blurred(optimizer.gaussians, scene, [views[i] for i in sorted(chosen)])
        split &= np.cumsum(split) <= max(0, most - optimizer.size)
        split_and_prune(optimizer, split, np.zeros(len(split), bool))
        return optimizer

    def _is_due(self, fraction: float, step: int) -> bool:
        """Returns whether this fraction of the steps has passed since the last densification."""
        return step - self.recipe.densify_every < math.ceil(fraction * self.options.steps) <= step
