"""MCMC: relocates dead Gaussians to where errors are; their number grows geometrically to a cap."""

from __future__ import annotations

from typing import Any

import numpy as np

from gsut.gaussians import Gaussians
from gsut.optimize import GaussianOptimizer, compute_target_size, densify_mcmc
from gsut.training.densification import Densification, DensificationStep

# A Gaussian's largest standard deviation, in units of its distance from the cameras' middle or of
# the extent, whichever is more. Larger ones become plates that every training view sees on edge
# and that hide a sky, or half a view, from elsewhere.
_LARGEST = 0.2


class Strategy(Densification):
    """Kheradmand et al., "3D Gaussian splatting as Markov chain Monte Carlo", 2024."""

    by_error = True

    def capacity(self) -> int | None:
        """The cap, so that nothing is copied on the way."""
        return max(self.options.max_gaussians, self.first_count)

    def add_gradients(self, optimizer: Any, gradients: Any) -> None:
        """Of the regularisers, which make what is not needed die."""
        o = self.options
        optimizer.add_regularizer(gradients, o.opacity_regularizer, o.scale_regularizer)

    def explore(self, optimizer: Any, rate_means: float) -> None:
        """Noise on the centres of what is hardly opaque."""
        if self.options.noise:
            optimizer.add_noise(rate_means)

    def densify(self, optimizer: GaussianOptimizer, now: DensificationStep) -> GaussianOptimizer:
        """Relocates the dead and adds what the schedule asks for."""
        size = optimizer.size
        if not now.full_grown:
            size = compute_target_size(self.options, self.first_count, now.fraction)
        densify_mcmc(optimizer, size, dead_opacity=self.options.dead_opacity)
        _limit_sizes(optimizer.gaussians, now)
        return optimizer

    def settle(self, optimizer: GaussianOptimizer, now: DensificationStep) -> None:
        """Keeps the sizes: plates grow in the last fifth of the steps as before."""
        _limit_sizes(optimizer.gaussians, now)


def _limit_sizes(gaussians: Gaussians, now: DensificationStep) -> None:
    views = [now.scene.views[index] for index in now.scene.train_indices]
    middle = np.mean([view.camera_center for view in views], axis=0)
    distances = np.linalg.norm(gaussians.means - middle, axis=1)
    largest = np.log(_LARGEST * np.maximum(distances, now.extent)).astype(np.float32)
    np.minimum(gaussians.log_scales, largest[:, None], out=gaussians.log_scales)
