"""Whether a photograph shows what is rendered: how many of its parts lie where the render has them.

A pose fitted to a photograph of another place makes the whole correlate: light above dark, a round
thing in the middle. Its parts do not follow: each of them, moved over the render by itself, fits
best somewhere else. Correlations are normalised part by part, so another light changes little.
"""

from __future__ import annotations

import cv2
import numpy as np

from gsut.data.images import shrink_image, shrink_mask
from gsut.sampling import ENOUGH_SAMPLES

# Pixels that are compared, about: a pose is found by this number, too.
COMPARED_PIXELS = ENOUGH_SAMPLES
# Parts along the side of a square of as many pixels as count.
_PARTS = 8
# Side of a part in pixels, at least: fewer are alike in many places.
_SMALLEST_PART = 6
# Standard deviation of the grey levels of a part, of 255, below which it shows nothing.
_LEAST_TEXTURE = 2.0
# Distance of a part from its place that counts as agreement, in such pixels.
_NEAR = 1.0


def measure_agreement(photograph: np.ndarray, seen: np.ndarray, mask: np.ndarray) -> float:
    """Measures the share of a photograph's parts that fit a render best where they are.

    Args:
        photograph, seen: (H, W, 3) uint8, the photograph and the render from its pose.
        mask: (H, W) bool, False where either does not count.

    Returns:
        0 to 1, of the parts that show texture; 0 if none does.
    """
    counted = max(1, int(np.count_nonzero(mask)))
    factor = min(1.0, float(np.sqrt(COMPARED_PIXELS / counted)))
    height, width = mask.shape
    size = [max(1, round(side * factor)) for side in (width, height)]
    grey, drawn = (
        shrink_image(image, *size).mean(axis=2, dtype=np.float32) for image in (photograph, seen)
    )
    valid = shrink_mask(mask, *size)
    part = max(_SMALLEST_PART, round(np.sqrt(np.count_nonzero(valid)) / _PARTS))
    around = part // 2
    agree: list[bool] = []
    for y in range(around, size[1] - part - around + 1, around):
        for x in range(around, size[0] - part - around + 1, around):
            here = np.s_[y : y + part, x : x + part]
            window = np.s_[y - around : y + part + around, x - around : x + part + around]
            if valid[here].all() and np.std(grey[here]) >= _LEAST_TEXTURE:
                agree.append(_find_shift(grey[here], drawn[window]) <= _NEAR)
    return float(np.mean(agree)) if agree else 0.0


def _find_shift(part: np.ndarray, window: np.ndarray) -> float:
    """Finds how far from the window's middle a part fits it best, pixels."""
    fit = cv2.matchTemplate(window, part, cv2.TM_CCOEFF_NORMED)
    fit = np.where(np.isfinite(fit) & (np.abs(fit) <= 1 + 1e-3), fit, -1.0)  # flat windows
    best = np.unravel_index(int(np.argmax(fit)), fit.shape)
    return float(np.hypot(*(np.array(best) - np.array(fit.shape) // 2)))
