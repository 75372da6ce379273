"""Point clouds: PLY files, and colours taken from the photographs."""

from gsut.data.points.colors import UNCOLORED, color_points, has_colors
from gsut.data.points.ply import (
    NO_COLOR,
    find_usable_points,
    format_points_ply,
    load_points,
    load_points_ply,
)
