"""Poses, trajectories, camera paths and the times of both."""

from gsut.data.poses.camera_path import read_path, read_path_lens
from gsut.data.poses.times import (
    NANOSECONDS,
    UNITS,
    format_range,
    format_seconds,
    guess_unit,
    is_time,
    to_nanoseconds,
)
from gsut.data.poses.trajectory import Trajectory, format_kitti, format_tum, read_trajectory
from gsut.data.poses.transforms import (
    FARTHEST,
    OPENGL_FROM_OPENCV,
    centers_of,
    halfway,
    inverse,
    pose_from_quaternion,
    rigid_transform,
)

__all__ = [
    "FARTHEST",
    "NANOSECONDS",
    "OPENGL_FROM_OPENCV",
    "UNITS",
    "Trajectory",
    "centers_of",
    "format_kitti",
    "format_range",
    "format_seconds",
    "format_tum",
    "guess_unit",
    "halfway",
    "inverse",
    "is_time",
    "pose_from_quaternion",
    "read_path",
    "read_path_lens",
    "read_trajectory",
    "rigid_transform",
    "to_nanoseconds",
]
