"""Poses, trajectories, camera paths and the times of both."""

from gsut.data.poses.camera_path import lens_of_path, read_path
from gsut.data.poses.times import (
    NANOSECONDS,
    UNITS,
    in_nanoseconds,
    is_time,
    range_text,
    seconds_text,
    unit_of,
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
    "format_tum",
    "halfway",
    "in_nanoseconds",
    "inverse",
    "is_time",
    "lens_of_path",
    "pose_from_quaternion",
    "range_text",
    "read_path",
    "read_trajectory",
    "rigid_transform",
    "seconds_text",
    "unit_of",
]
