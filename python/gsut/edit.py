"""Edit Gaussians: merge, cut, transform, level, repeat edits by hand, remove floaters."""

from __future__ import annotations

import numpy as np

from gsut.bounds import name_wrong_kinds
from gsut.compact import SeenView, Support, find_support, list_seen_views
from gsut.gaussians import (
    Gaussians,
    find_ground,
    merge_gaussians,
    rotate_upright,
    transform_gaussians,
)
from gsut.hand_edits import apply_edits, read_edits

__all__ = [
    "SeenView",
    "Support",
    "apply_edits",
    "find_ground",
    "find_support",
    "is_inside_box",
    "list_seen_views",
    "merge_gaussians",
    "read_edits",
    "rotate_upright",
    "transform_gaussians",
]


@name_wrong_kinds
def is_inside_box(gaussians: Gaussians, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Returns which Gaussians have their centres in a box.

    Args:
        gaussians: N Gaussians.
        low: (3,) corner of the box, world coordinates.
        high: (3,) the opposite corner.

    Returns:
        (N,) bool.
    """
    places = gaussians.means + (gaussians.origin - np.asarray(low, np.float64))
    size = np.asarray(high, np.float64) - low
    return np.all((places >= 0) & (places <= size), axis=1)
