"""Poses, trajectories, camera paths and the times of both."""

from gsut.data.poses.camera_path import read_path, read_path_lens, read_path_turns
from gsut.data.poses.times import (
    NANOSECONDS,
    UNITS,
    format_range,
    format_seconds,
    guess_unit,
    is_time,
    to_nanoseconds,
)
from gsut.data.poses.trajectory import Trajectory, format_tum, read_trajectory
from gsut.data.poses.transforms import (
    OPENGL_FROM_OPENCV,
    average_poses,
    check_rigid,
    find_centers,
    interpolate_between,
    invert_pose,
    pose_from_quaternion,
)

__all__ = [
    "NANOSECONDS",
    "OPENGL_FROM_OPENCV",
    "UNITS",
    "Trajectory",
    "average_poses",
    "check_rigid",
    "find_centers",
    "format_range",
    "format_seconds",
    "format_tum",
    "guess_unit",
    "interpolate_between",
    "invert_pose",
    "is_time",
    "pose_from_quaternion",
    "read_path",
    "read_path_lens",
    "read_path_turns",
    "read_trajectory",
    "to_nanoseconds",
]
