"""What stands where no Gaussian was ever placed: a soft colour, carried in from all around.

A pull-push pyramid: an image and how much of it is covered are halved until one pixel is left; on
the way back each level keeps what it knows and takes the rest from the coarser one.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from gsut.render.light import compute_field_angles

# Share of a pixel that may be open before anything is filled in: half a grey level at most.
_OPEN = 0.002
_FIRST = 4  # pixels a side that the finest level of the pyramid joins: what is filled in is soft


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
    import cv2

    no_ray = np.isnan(compute_field_angles(camera))
    if not (~no_ray & (alpha < 1.0 - _OPEN)).any():
        return None
    height, width = alpha.shape
    known = np.empty((height, width, 4), np.float32)
    known[..., :3], known[..., 3] = image, alpha
    known[no_ray] = 0.0
    levels: list[Any] = [known]
    factor = _FIRST
    while max(levels[-1].shape[:2]) > 1:
        rows, columns = (-(-side // factor) for side in levels[-1].shape[:2])
        levels.append(cv2.resize(levels[-1], (columns, rows), interpolation=cv2.INTER_AREA))
        factor = 2
    out: Any = levels.pop().reshape(1, 1, 4)
    out = out[..., :3] / max(float(out[..., 3].max()), float(np.finfo(np.float32).tiny))
    for level in reversed(levels[1:]):
        out = cv2.resize(out, level.shape[1::-1], interpolation=cv2.INTER_LINEAR)
        out = level[..., :3] + (1.0 - level[..., 3:]) * out
    out = cv2.resize(out, (width, height), interpolation=cv2.INTER_LINEAR)
    out[no_ray] = 0.0
    return out


def with_surroundings(image: np.ndarray, alpha: np.ndarray, camera: Any) -> np.ndarray:
    """Fills the open share of an image (H, W, 3) over black with the colour of its surroundings."""
    behind = compute_surroundings(image, alpha, camera)
    return image if behind is None else image + (1.0 - alpha)[..., None] * behind
