"""Makes the demo's lens and the walk of its camera."""

from __future__ import annotations

import math

import numpy as np

from gsut.lens import Camera

# The lens: focal lengths and centre in image sizes, Kannala-Brandt k1..k4, a 190-degree circle.
_FOCAL = (0.2782, 0.2786)
_CENTRE = (0.5031, 0.4974)
_DISTORTION = (0.030, -0.010, 0.003, -0.0005)
MAX_ANGLE = math.radians(95.0)


def make_camera(size: int) -> Camera:
    """Makes the demo's fisheye for square images of `size` pixels a side."""
    params = [size * value for value in (*_FOCAL, *_CENTRE)] + list(_DISTORTION)
    return Camera("kannala_brandt", params, size, size, valid_field_angle=MAX_ANGLE)


def plan_walk(count: int, seed: int) -> list[np.ndarray]:
    """Plans world-from-camera poses (4, 4), OpenCV axes, on a walk around the table; metres."""
    rng = np.random.default_rng([seed, 1])
    phase = rng.uniform(0, 2 * math.pi, 4)
    poses = []
    for i in range(count):
        turn = 2 * math.pi * i / count
        # Two rounds: one near the table, one nearer to the walls.
        reach = 1.0 + 0.22 * math.sin(3 * turn + phase[0])
        x, y = 2.15 * reach * math.cos(2 * turn), 1.65 * reach * math.sin(2 * turn)
        z = 1.55 + 0.40 * math.sin(5 * turn + phase[1])
        yaw = 2 * turn + math.pi / 2 + 1.6 * math.sin(7 * turn + phase[2])
        pitch = -0.10 + 0.35 * math.sin(4 * turn + phase[3])
        poses.append(_look_along((x, y, z), yaw, pitch))
    return poses


def _look_along(position: tuple[float, float, float], yaw: float, pitch: float) -> np.ndarray:
    forward = np.array(
        [math.cos(yaw) * math.cos(pitch), math.sin(yaw) * math.cos(pitch), math.sin(pitch)]
    )
    right = np.array([math.sin(yaw), -math.cos(yaw), 0.0])
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    pose[:3, 3] = position
    return pose
