"""Point clouds: PLY files, and colours taken from the photographs."""

from gsut.data.points.colors import UNCOLORED, color_points, has_colors, points_seen
from gsut.data.points.ply import NO_COLOR, TRIANGULATED, load_points_ply, points_ply, usable_points

__all__ = [
    "NO_COLOR",
    "TRIANGULATED",
    "UNCOLORED",
    "color_points",
    "has_colors",
    "load_points_ply",
    "points_ply",
    "points_seen",
    "usable_points",
]
