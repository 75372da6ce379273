"""Adaptive density control: clone and split by gradient, prune, reset opacities now and then."""

from __future__ import annotations

import math

from gsut.optimize import GaussianOptimizer, densify_adaptive
from gsut.training.densification import Densification, DensificationStep

# Opacities are lowered every so many of the steps, of 30 000 (3DGS), and the sizes that separate
# cloning from splitting and that are pruned, in units of the extent.
_RESET_FRACTION = 0.1
CLONE_SCALE, PRUNE_SCALE = 0.01, 0.1


class Strategy(Densification):
    """Kerbl et al., "3D Gaussian splatting for real-time radiance field rendering", 2023."""

    def densify(self, optimizer: GaussianOptimizer, now: DensificationStep) -> GaussianOptimizer:
        """Clones, splits and prunes; every tenth of the steps lowers the opacities."""
        o = self.options
        densify_adaptive(
            optimizer,
            clone_scale=CLONE_SCALE * now.extent,
            max_scale=PRUNE_SCALE * now.extent,
            prune_opacity=o.dead_opacity,
            max_gaussians=optimizer.size if now.full_grown else o.max_gaussians,
        )
        resets = max(1, round(_RESET_FRACTION * o.steps))
        if now.step % (math.ceil(resets / o.densify_every) * o.densify_every) == 0:
            optimizer.reset_opacities()
        return optimizer
