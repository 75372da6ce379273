"""Edit Gaussians: merge, cut, transform, level, and remove what no photograph supports."""

from gsut.compact import SeenView, Support, find_support, list_seen_views
from gsut.gaussians import (
    find_ground,
    is_inside_box,
    is_inside_sphere,
    merge_gaussians,
    rotate_upright,
    transform_gaussians,
)

__all__ = [
    "SeenView",
    "Support",
    "find_ground",
    "find_support",
    "is_inside_box",
    "is_inside_sphere",
    "list_seen_views",
    "merge_gaussians",
    "rotate_upright",
    "transform_gaussians",
]
