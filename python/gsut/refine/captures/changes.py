"""Finds what has changed between two captures of a place."""

from __future__ import annotations

from typing import Any

import numpy as np

from gsut.bounds import name_wrong_kinds
from gsut.gaussians import OPAQUE, Gaussians
from gsut.render import render, to_uint8

# Times the difference of half of all pixels, from which one has changed.
_CHANGED = 6.0
# Least difference of colour, of [0, 1], that is a change.
_LEAST_CHANGE = 0.1
# Side of the squares in which colours are averaged: edges are never at the same place twice.
_SQUARE = 5
_FADED = 0.3  # of the picture below the red
_RED = (178, 0, 0)


@name_wrong_kinds
def find_changes(
    gaussians: Gaussians, other: Gaussians, camera: Any, pose: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Finds what differs between two scenes of one frame, where a camera sees both.

    Colours are averaged over small squares, and the second's get the first's mean and spread,
    as exposures differ from day to day.

    Args:
        gaussians, other: the scenes.
        camera: a lens.
        pose: (4, 4) camera_from_world.

    Returns:
        (H, W) bool, and (H, W, 3) uint8: the second scene, with what has changed in red.
    """
    import cv2

    one, two = (
        render(each, camera, pose, background=(0.0, 0.0, 0.0)) for each in (gaussians, other)
    )
    seen = (np.asarray(one.alpha) > OPAQUE) & (np.asarray(two.alpha) > OPAQUE)
    shown = to_uint8(two.image)
    if not seen.any():
        return np.zeros(seen.shape, bool), shown
    first, second = (cv2.blur(np.asarray(each.image), (_SQUARE, _SQUARE)) for each in (one, two))
    spread = first[seen].std(axis=0) / np.maximum(
        second[seen].std(axis=0), np.finfo(np.float32).eps
    )
    second = (second - second[seen].mean(axis=0)) * spread + first[seen].mean(axis=0)
    difference = np.abs(first - second).max(axis=2)
    limit = max(_LEAST_CHANGE, _CHANGED * float(np.median(difference[seen])))
    changed = seen & (difference > limit)
    shown[changed] = (_FADED * shown[changed] + _RED).astype(np.uint8)
    return changed, shown
