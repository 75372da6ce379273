"""Points seen by photographs whose poses are known, and how well their rays meet."""

from gsut.sfm.points.bearing_points import BearingPoints
from gsut.sfm.points.epipolar import (
    compute_readout_poses,
    find_readout_moments,
    measure_angular_errors,
    measure_pixels_per_radian,
)
from gsut.sfm.points.triangulation import TriangulatedPoints, triangulate

__all__ = [
    "BearingPoints",
    "TriangulatedPoints",
    "compute_readout_poses",
    "find_readout_moments",
    "measure_angular_errors",
    "measure_pixels_per_radian",
    "triangulate",
]
