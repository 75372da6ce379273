"""Where a view is while it reads a line, and where it sees points: one pose, or a rolling one."""

from __future__ import annotations

from typing import Any

import numpy as np

from gsut._core import CameraMotion

_LINE_STEPS = 4  # until a point has settled on its line of a rolling shutter
_TIMES = 256  # of the exposure, that poses are told apart at


def project_points(
    camera: Any, motion: Any, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points (n, 3) of the world in a view, each placed by the pose of the line that sees it.

    Args:
        camera: of the view.
        motion: `View.motion`.
        points: in the scene's coordinates.

    Returns:
        In the camera's axes (n, 3); pixels (n, 2), NaN where there is none; valid (n,) bool.
    """
    if not isinstance(motion, CameraMotion):
        in_camera = points @ motion[:3, :3].T + motion[:3, 3]
        return in_camera, *camera.project(in_camera)
    times = np.full(len(points), 0.5)
    for _ in range(_LINE_STEPS):
        poses = poses_at(motion, times)
        in_camera = np.einsum("nij,nj->ni", poses[:, :3, :3], points) + poses[:, :3, 3]
        pixels, valid = camera.project(in_camera)
        times = line_times(camera, motion, np.nan_to_num(pixels))
    return in_camera, pixels, valid


def poses_at(motion: CameraMotion, times: np.ndarray) -> np.ndarray:
    """(n, 4, 4) camera_from_world at times (n,) of the exposure, from 0 to 1."""
    steps, which = np.unique(np.round(times * _TIMES) / _TIMES, return_inverse=True)
    return np.stack([motion.at(time) for time in steps])[which]


def line_times(camera: Any, motion: CameraMotion, pixels: np.ndarray) -> np.ndarray:
    """Of the exposure, when the lines of pixels (n, 2) are read."""
    lines = motion.shutter.line_times(camera.width, camera.height)
    along = pixels[:, 0 if "left" in motion.shutter.direction else 1]
    return np.interp(along - 0.5, np.arange(len(lines)), lines)
