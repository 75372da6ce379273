"""More about rendering: camera paths, 8-bit images, distances and depths, projections."""

from gsut.render import METHODS as PROJECTION_METHODS
from gsut.render import Projection, auto_path, orbit_path, smooth_path, to_uint8, z_of_distance

__all__ = [
    "PROJECTION_METHODS",
    "Projection",
    "auto_path",
    "orbit_path",
    "smooth_path",
    "to_uint8",
    "z_of_distance",
]
