"""How well the rays of photographs whose poses are known meet."""

from gsut.judge import (
    compute_readout_poses,
    find_readout_moments,
    measure_angular_errors,
    measure_pixels_per_radian,
)

__all__ = [
    "compute_readout_poses",
    "find_readout_moments",
    "measure_angular_errors",
    "measure_pixels_per_radian",
]
