"""Poses compared with a reference, and placed in the world of positions or of the earth."""

from gsut.sfm.world.comparison import PoseErrors, compare_poses, errors_against, poses_by_path
from gsut.sfm.world.earth import find_earth, moved_solution
from gsut.sfm.world.positions import PositionFit, fit_positions, read_positions

__all__ = [
    "PoseErrors",
    "PositionFit",
    "compare_poses",
    "errors_against",
    "find_earth",
    "fit_positions",
    "moved_solution",
    "poses_by_path",
    "read_positions",
]
