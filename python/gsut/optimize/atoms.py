"""Makes atoms: Gaussians with one scale, which the optimizer keeps so.

Source: Liu et al., "AtomGS: atomizing Gaussian splatting for high-fidelity radiance field", 2024,
whose sizes are also quantised; here they are free.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from gsut.gaussians import Gaussians


def sum_scale_gradients(gradients: np.ndarray) -> None:
    """Replaces gradients (N, 3) of logarithms of scales by that of their common value, in place."""
    gradients[:] = gradients.sum(axis=1, keepdims=True)


def to_atoms(gaussians: Gaussians) -> Gaussians:
    """Makes Gaussians round: each scale becomes the geometric mean of the three."""
    mean = gaussians.log_scales.mean(axis=1, keepdims=True)
    return dataclasses.replace(gaussians, log_scales=np.repeat(mean, 3, axis=1))
