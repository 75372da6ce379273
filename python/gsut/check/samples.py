"""What the doctor's checks look at: small pictures, and views of which something is the same."""

import itertools
from collections.abc import Hashable, Mapping

import numpy as np

from gsut.data.images import shrink_image

SIDE = 640  # pixels of the images on which pixels and lenses are checked


def shrink_to_grey(pixels: np.ndarray) -> np.ndarray:
    """Shrinks (H, W, 3) uint8 to at most `SIDE` columns of grey levels."""
    import cv2

    height, width = pixels.shape[:2]
    size = min(SIDE, width), max(1, round(height * min(SIDE, width) / width))
    return shrink_image(cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY), *size)


def pair_equal(keys: Mapping[int, Hashable]) -> list[tuple[int, int]]:
    """Pairs the views whose keys are equal."""
    groups: dict[Hashable, list[int]] = {}
    for view, key in keys.items():
        groups.setdefault(key, []).append(view)
    return [pair for views in groups.values() for pair in itertools.combinations(views, 2)]
