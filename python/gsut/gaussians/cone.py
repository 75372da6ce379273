"""Finds the Gaussians that rays may see, by the cone around them."""

from __future__ import annotations

from typing import Any

import numpy as np

from gsut import _core

# Alpha below which nothing is drawn, as in the blend rule of 3DGS.
LEAST_ALPHA = 1.0 / 255.0
# Alpha from which a pixel shows a surface.
OPAQUE = 0.5


def compute_reach(gaussians: Any) -> np.ndarray:
    """Computes (N,) the distance from its centre beyond which no ray sees a Gaussian."""
    squared = _core.compute_cutoffs(
        gaussians.primitive,
        gaussians.response,
        gaussians.opacity_logits.astype(np.float64),
        LEAST_ALPHA,
    )
    return np.sqrt(squared) * np.exp(gaussians.log_scales.max(axis=1).astype(np.float64))


def find_seen(offset: np.ndarray, reach: np.ndarray, rays: np.ndarray, margin: float) -> np.ndarray:
    """Finds which balls (N,) bool the cone around rays touches.

    Args:
        offset: (N, 3) centres about the rays' start. reach: (N,) radii.
        rays: (n, 3) unit vectors, n > 0. margin: angle about the cone that counts, radians.
    """
    axis = rays.sum(axis=0)
    length = float(np.linalg.norm(axis))
    axis = axis / length if length > 1e-9 else rays[0]
    half_angle = float(np.arccos(np.clip((rays @ axis).min(), -1.0, 1.0))) + margin
    away = np.linalg.norm(offset, axis=1)
    far = np.maximum(away, 1e-300)
    angle = np.arccos(np.clip(offset @ axis / far, -1.0, 1.0))
    covered = np.arcsin(np.minimum(reach / far, 1.0))
    return (away <= reach) | (angle - covered <= half_angle)
