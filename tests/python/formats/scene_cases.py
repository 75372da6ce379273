"""Gaussians that all formats hold without clipping."""

import numpy as np

from gsut import Gaussians


def plain_scene(rng, count=2000, coefficients=16):
    """Coordinates to 8, opacities from 0.02 to 0.98, colours of the screen, modest harmonics."""
    sh = rng.uniform(-0.7, 0.7, (count, coefficients, 3))
    sh[:, 0] = rng.uniform(-1.7, 1.7, (count, 3))
    return Gaussians(
        rng.uniform(-8, 8, (count, 3)).astype(np.float32),
        rng.normal(size=(count, 4)),
        rng.uniform(-7, 0, (count, 3)),
        rng.uniform(-4, 4, count),
        sh,
    )
