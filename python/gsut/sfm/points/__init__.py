"""How well the rays of photographs whose poses are known meet."""

from gsut.sfm.points.bearing_points import BearingPoints
from gsut.sfm.points.epipolar import (
    compute_readout_poses,
    find_readout_moments,
    measure_angular_errors,
    measure_pixels_per_radian,
)

__all__ = [
    "BearingPoints",
    "compute_readout_poses",
    "find_readout_moments",
    "measure_angular_errors",
    "measure_pixels_per_radian",
]
