"""More about rendering: camera paths, 8-bit images, depths, projections, confidence, lifting."""

from gsut.compact import measure_confidence
from gsut.lifting import Lifted, MapFolder, judge_lifted
from gsut.render import METHODS as PROJECTION_METHODS
from gsut.render import (
    Confidence,
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
    "Confidence",
    "Lifted",
    "MapFolder",
    "Projection",
    "judge_lifted",
    "make_orbit_path",
    "make_tour_path",
    "measure_confidence",
    "measure_depth",
    "smooth_path",
    "to_uint8",
    "z_from_distance",
]
