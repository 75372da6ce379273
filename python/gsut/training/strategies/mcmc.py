"""MCMC: relocates dead Gaussians to where errors are; their number grows to a cap, or beyond it."""

from __future__ import annotations

from typing import Any

import numpy as np

from gsut.compact import compact, list_seen_views
from gsut.data import Scene
from gsut.gaussians import Gaussians
from gsut.optimize import GaussianOptimizer, compute_target_size, densify_mcmc
from gsut.training.densification import Densification, DensificationStep

# Largest standard deviation of a Gaussian, x its distance from the cameras' middle or the scene's
# extent, whichever is more. Larger ones become plates that training views see edge-on and that
# hide a sky, or half a view, from elsewhere.
_LARGEST = 0.2
# Most views through which the merging of Gaussians is weighted: more cost time, not quality.
_WEIGHED_VIEWS = 8


class Strategy(Densification):
    """Kheradmand et al., "3D Gaussian splatting as Markov chain Monte Carlo", 2024."""

    by_error = True

    @property
    def capacity(self) -> int | None:
        """The largest number, so that growth copies nothing."""
        return max(round(self.recipe.overgrowth * self.options.max_gaussians), self.first_count)

    def add_gradients(self, optimizer: Any, gradients: Any) -> None:
        """Adds the gradients of the regularizers, which make unneeded Gaussians die."""
        optimizer.add_regularizer(gradients, self.recipe.regularizer, self.recipe.regularizer)

    def explore(self, optimizer: Any, rate_means: float) -> None:
        """Adds noise to the centres of nearly transparent Gaussians."""
        if self.recipe.noise:
            optimizer.add_noise(rate_means)

    def densify(self, optimizer: GaussianOptimizer, now: DensificationStep) -> GaussianOptimizer:
        """Relocates dead Gaussians, and adds or merges the number that the schedule requires."""
        most, overgrowth = self.options.max_gaussians, self.recipe.overgrowth
        target = compute_target_size(most, self.first_count, now.fraction, overgrowth)
        if optimizer.size > target and overgrowth > 1.0:
            return optimizer.restart_with(self._merge(optimizer.gaussians, target, now.scene))
        densify_mcmc(optimizer, target)
        _limit_sizes(optimizer.gaussians, now)
        return optimizer

    def settle(self, optimizer: GaussianOptimizer, now: DensificationStep) -> None:
        """Keeps limiting sizes: plates would grow in the last fifth of the steps, too."""
        _limit_sizes(optimizer.gaussians, now)

    def _merge(self, gaussians: Gaussians, count: int, scene: Scene) -> Gaussians:
        """Merges neighbours to `count` Gaussians where the training views show it least."""
        indices = scene.train_indices
        views = list_seen_views(scene, indices[:: -(-len(indices) // _WEIGHED_VIEWS)])
        return compact(gaussians, count=count, method="field", views=views).gaussians


def _limit_sizes(gaussians: Gaussians, now: DensificationStep) -> None:
    """Reduces the scales of Gaussians that are too large for their distance."""
    views = [now.scene.views[index] for index in now.scene.train_indices]
    middle = np.mean([view.camera_center for view in views], axis=0)
    distances = np.linalg.norm(gaussians.means - middle, axis=1)
    largest = np.log(_LARGEST * np.maximum(distances, now.extent)).astype(np.float32)
    np.minimum(gaussians.log_scales, largest[:, None], out=gaussians.log_scales)
