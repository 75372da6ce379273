"""Adaptive density control: clones and splits by gradient, prunes, and resets opacities."""

from __future__ import annotations

import math

from gsut.optimize import GaussianOptimizer, densify_adaptive
from gsut.training.densification import Densification, DensificationStep

# Fraction of the steps between resets of the opacities, 3000 of 30,000 steps (3DGS).
_RESET_FRACTION = 0.1
# Size below which a Gaussian is cloned, above which it is split, x scene extent (3DGS).
CLONE_SCALE = 0.01
# Size above which a Gaussian is pruned, x scene extent (3DGS).
PRUNE_SCALE = 0.1


class Strategy(Densification):
    """Kerbl et al., "3D Gaussian splatting for real-time radiance field rendering", 2023."""

    def densify(self, optimizer: GaussianOptimizer, now: DensificationStep) -> GaussianOptimizer:
        """Clones, splits and prunes; resets the opacities once every tenth of the steps."""
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
