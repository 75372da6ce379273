"""Carries the motion of images during their readouts to the rig, and to the rig's file."""

from __future__ import annotations

import numpy as np

from gsut import _core
from gsut._core import Shutter
from gsut.data.poses import invert_pose
from gsut.data.rigs import LineReading, Rig
from gsut.sfm.photographs import ImageLines
from gsut.sfm.solution import ReadoutMotion, RigConstraint, Solution


def find_image_lines(rig: Rig, cameras: np.ndarray) -> tuple[Shutter | None, ImageLines | None]:
    """Finds how each image is read by what the rig's file says.

    Args:
        cameras: (N,) the camera of each image.

    Returns:
        The shutter of the rig, None: global; and the lines of each image if cameras differ.
    """
    known = [reading for reading in rig.readings if reading is not None]
    if not known:
        return None, None
    longest = max(reading.seconds or 1.0 for reading in known)
    lengths = np.array([(r.seconds or 1.0) / longest if r else 0.0 for r in rig.readings])
    shutters = [reading.shutter if reading else None for reading in rig.readings]
    directions = {shutter.direction if shutter else None for shutter in shutters}
    if len(directions) == 1 and (lengths == 1.0).all():
        return known[0].shutter, None
    return known[0].shutter, ImageLines([shutters[c] for c in cameras], lengths[cameras])


def list_readings(
    solution: Solution, cameras: np.ndarray, seconds: float | None
) -> tuple[LineReading | None, ...]:
    """Lists how each camera of a rig reads its lines, as the solution took it.

    Args:
        cameras: (N,) the camera of each image.
        seconds: of the longest readout; None: not known.
    """
    if solution.shutter is None:
        return ()
    found: list[LineReading | None] = []
    for camera in range(int(cameras.max()) + 1):
        image = int(np.argmax(cameras == camera))
        shutter = solution.shutters[image]
        length = 1.0 if solution.lines is None else float(solution.lines.readouts[image])
        own = None if seconds is None else seconds * length
        found.append(None if shutter is None else LineReading(shutter, own))
    return tuple(found)


def find_body_motion(
    alone: Solution, scale: float, constraint: RigConstraint, sigma: float
) -> ReadoutMotion | None:
    """Finds the motion of the rig's body at each frame; None for a global shutter.

    Args:
        alone: images placed one by one, each with the velocity of its own camera.
        scale: of the rig's unit over that of their poses, which the velocities get.
        constraint: the cameras' mounts.
        sigma: share of itself that a body's velocity may differ by from the mean over its images.
    """
    if alone.shutter is None or alone.velocities is None:
        return None
    readouts = np.ones(len(alone.names)) if alone.lines is None else alone.lines.readouts
    seen = np.bincount(alone.observations[:, 1], minlength=len(readouts))
    total = np.zeros((int(constraint.body_of_image.max()) + 1, 6))
    weight = np.zeros(len(total))
    known = alone.registered & (readouts > 0) & np.isfinite(alone.velocities).all(axis=1)
    for image in np.flatnonzero(known):
        velocity = alone.velocities[image] / readouts[image]
        velocity[:3] *= scale
        pose = alone.camera_from_world[image].copy()
        pose[:3, 3] *= scale
        mount = int(constraint.mount_of_image[image])
        back = np.eye(4) if mount < 0 else invert_pose(constraint.camera_from_body[mount])
        body = constraint.body_of_image[image]
        total[body] += seen[image] * find_body_velocity(pose, velocity, back)
        weight[body] += seen[image]
    with np.errstate(invalid="ignore"):
        rates = total / weight[:, None]
    return ReadoutMotion(alone.shutter, 1.0, rates[constraint.body_of_image], sigma=sigma)


def find_body_velocity(
    camera_from_world: np.ndarray, velocity: np.ndarray, body_from_camera: np.ndarray
) -> np.ndarray:
    """Finds the velocity (6,) of a body whose camera moves so; see `Solution.velocities`."""
    ends = [
        body_from_camera @ _core.moved_pose(camera_from_world, velocity, time)
        for time in (-0.5, 0.5)
    ]
    return np.asarray(_core.velocity_between(*ends))
