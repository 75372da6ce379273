"""Mini-Splatting's densification: blur split, depth re-initialisation, importance sampling."""

from __future__ import annotations

import math

import numpy as np

from gsut.compact import blend_weights, find_strongest, seen_views
from gsut.data import Scene
from gsut.gaussians import Gaussians, seed_from_points
from gsut.optimize import GaussianOptimizer, densify_adaptive, split_and_prune
from gsut.run import TrainOptions
from gsut.training.densification import Densification, DensificationStep
from gsut.training.strategies.adaptive import CLONE_SCALE, PRUNE_SCALE

# A Gaussian that is the strongest at more than this fraction of a view's valid pixels is blurred
# (publication), and the number of views that are looked at each time, drawn anew.
BLUR_FRACTION = 2e-4
_BLUR_VIEWS = 8
# Fractions of the steps: new Gaussians at the depths seen; and where growth ends, by sampling.
REINIT_AT, SAMPLE_AT = 0.25, 0.5
# Growth until then, in multiples of --max-gaussians.
OVERGROWN = 3


def find_blurred(gaussians: Gaussians, scene: Scene, indices: list[int]) -> np.ndarray:
    """(N,) bool: the strongest at more than `BLUR_FRACTION` of some view's valid pixels.

    Args:
        gaussians: N Gaussians.
        scene: at the resolution to look at.
        indices: of the views.
    """
    found = np.zeros(len(gaussians), bool)
    for view in seen_views(scene, indices):
        winner, _ = find_strongest(gaussians, view)
        counts = np.bincount(winner[winner >= 0], minlength=len(gaussians))
        found |= counts > max(1.0, BLUR_FRACTION * np.count_nonzero(view.mask))
    return found


def reinitialize(
    gaussians: Gaussians, scene: Scene, options: TrainOptions, count: int, seed: list[int]
) -> Gaussians:
    """New Gaussians on the surfaces that the training views see, in their photographs' colours.

    Args:
        gaussians: which show the surfaces: a point of each pixel's ray, where it is nearest to the
            centre of the pixel's strongest Gaussian.
        scene: at the resolution to look at.
        options: shape and harmonics of first Gaussians.
        count: how many, spread evenly over the views; fewer if there are not as many pixels.
        seed: of the choice of pixels.
    """
    rng, views = np.random.default_rng(seed), scene.train_indices
    points, colors = [], []
    for number, index in enumerate(views):
        share = (number + 1) * count // len(views) - number * count // len(views)
        winner, point = find_strongest(gaussians, seen_views(scene, [index])[0])
        pixels = np.flatnonzero(winner >= 0)
        pixels = np.sort(rng.choice(pixels, min(share, len(pixels)), replace=False))
        points.append(point.reshape(-1, 3)[pixels])
        colors.append(scene.image(index).reshape(-1, 3)[pixels])
    return seed_from_points(
        np.concatenate(points), np.concatenate(colors), sh_degree=options.sh_degree,
        scale_factor=options.init_scale, opacity=options.init_opacity, seed=options.seed,
    )  # fmt: skip


def sample(gaussians: Gaussians, scene: Scene, count: int, seed: list[int]) -> np.ndarray:
    """(N,) bool: which Gaussians stay, drawn in proportion to their blend weights.

    Only those that are the strongest somewhere are drawn from (intersection preserving).

    Args:
        gaussians: N Gaussians.
        scene: at the resolution to look at, through all its training views.
        count: how many, at most.
        seed: of the draw.
    """
    views = seen_views(scene, scene.train_indices)
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
        """Clones and splits by gradient and blur, or does what its step brings."""
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
            clone_scale=CLONE_SCALE * now.extent,
            max_scale=PRUNE_SCALE * now.extent,
            prune_opacity=o.dead_opacity,
            max_gaussians=most,
        )
        views = scene.train_indices
        chosen = np.random.default_rng(seed).permutation(len(views))[:_BLUR_VIEWS]
        split = find_blurred(optimizer.gaussians, scene, [views[i] for i in sorted(chosen)])
        split &= np.cumsum(split) <= max(0, most - optimizer.size)
        split_and_prune(optimizer, split, np.zeros(len(split), bool))
        return optimizer

    def _is_due(self, fraction: float, step: int) -> bool:
        """Whether this fraction of the steps has passed since the last densification."""
        o = self.options
        return step - o.densify_every < math.ceil(fraction * o.steps) <= step
