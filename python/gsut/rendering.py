"""More about rendering: camera paths, 8-bit images, distances and depths, projections."""

from gsut.render import METHODS as PROJECTION_METHODS
from gsut.render import (
    Projection,
    make_orbit_path,
    make_tour_path,
    measure_depth,
    smooth_path,
    to_uint8,
    z_from_distance,
)

__all__ = [
    "PROJECTION_METHODS",
    "Projection",
    "make_orbit_path",
    "make_tour_path",
    "measure_depth",
    "smooth_path",
    "to_uint8",
    "z_from_distance",
]
