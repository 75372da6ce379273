"""How much of a dataset the doctor's checks examine, and what they trust."""

import numpy as np

from gsut.data.images import shrink_image

SIDE = 640  # pixels of the images on which pixels and lenses are checked


def shrink_to_grey(pixels: np.ndarray) -> np.ndarray:
    """Shrinks (H, W, 3) uint8 to at most `SIDE` columns of grey levels."""
    import cv2

    height, width = pixels.shape[:2]
    size = min(SIDE, width), max(1, round(height * min(SIDE, width) / width))
    return shrink_image(cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY), *size)
