"""MCMC: relocates dead Gaussians onto living ones; their number grows geometrically to a cap."""

from __future__ import annotations

from typing import Any

from gsut.optimize import GaussianOptimizer, densify_mcmc, grown_count
from gsut.training.densification import Densification, DensificationStep


class Strategy(Densification):
    """Kheradmand et al., "3D Gaussian splatting as Markov chain Monte Carlo", 2024."""

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
            size = grown_count(self.options, self.first_count, now.fraction)
        densify_mcmc(optimizer, size, dead_opacity=self.options.dead_opacity)
        return optimizer
