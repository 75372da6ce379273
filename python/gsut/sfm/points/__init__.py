"""Points seen by photographs whose poses are known."""

from gsut.sfm.points.bearing_points import BearingPoints
from gsut.sfm.points.triangulation import TriangulatedPoints, triangulate

__all__ = ["BearingPoints", "TriangulatedPoints", "triangulate"]
