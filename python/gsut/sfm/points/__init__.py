"""How well the rays of photographs whose poses are known meet."""

from gsut.judge import (
    compute_readout_poses,
    find_readout_moments,
    measure_angular_errors,
    measure_pixels_per_radian,
)
from gsut.sfm.points.bearing_points import BearingPoints

__all__ = [
    "BearingPoints",
    "compute_readout_poses",
    "find_readout_moments",
    "measure_angular_errors",
    "measure_pixels_per_radian",
]
