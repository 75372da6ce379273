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
    move_poses,
    pose_from_quaternion,
    split_similarity,
)
