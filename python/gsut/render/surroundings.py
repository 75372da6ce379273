"""What stands where no Gaussian was ever placed: a soft colour, carried in from all around."""

from __future__ import annotations

from typing import Any

import numpy as np

from gsut import _core
from gsut.render.light import compute_field_angles


def choose_solid(background: tuple[float, float, float] | None) -> tuple[float, float, float]:
    """Returns a colour for code that needs one: black for None (the surroundings)."""
    return (0.0, 0.0, 0.0) if background is None else background


def compute_surroundings(image: np.ndarray, alpha: np.ndarray, camera: Any) -> np.ndarray | None:
    """Computes the mean colour of what is covered around each pixel, weighted towards near it.

    Args:
        image: (H, W, 3) float32 over a black background.
        alpha: (H, W) share of each pixel that is covered.
        camera: which pixels have a ray.

    Returns:
        (H, W, 3) float32; None where all is covered. Black where nothing is.
    """
    return _core.compute_surroundings(image, alpha, ~np.isnan(compute_field_angles(camera)))


def with_surroundings(image: np.ndarray, alpha: np.ndarray, camera: Any) -> np.ndarray:
    """Fills the open share of an image (H, W, 3) over black with the colour of its surroundings."""
    behind = compute_surroundings(image, alpha, camera)
    return image if behind is None else image + (1.0 - alpha)[..., None] * behind
