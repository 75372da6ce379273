"""Where a camera is while it takes a picture: one pose, or with a rolling shutter a motion."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from gsut import _core
from gsut._core import InputError


def to_matrix(camera_from_world: Any) -> np.ndarray:
    matrix = getattr(camera_from_world, "matrix", camera_from_world)
    return _core.read_array(matrix, "camera_from_world").astype(np.float64, copy=False)


def read_motion(
    camera_from_world: Any, shutter: _core.Shutter | str | None = None
) -> np.ndarray | _core.CameraMotion:
    """Reads a camera's place as the core takes it: one pose, or a moving camera.

    Args:
        camera_from_world: (4, 4), an object with such a `matrix`, or a pair of these: the poses at
            the start and at the end of the exposure. A `CameraMotion` is returned as it is.
        shutter: of a pair; a name stands for `Shutter(name)`.

    Raises:
        InputError: a pair without a rolling shutter, or a rolling shutter without a pair.
    """
    if isinstance(camera_from_world, _core.CameraMotion):
        if shutter is not None:
            raise InputError("the camera's motion has its shutter already: leave shutter out")
        return camera_from_world
    if isinstance(shutter, str):
        shutter = _core.Shutter(shutter)
    if shutter is not None and shutter.is_global:
        shutter = None
    if not _is_pair(camera_from_world):
        if shutter is not None:
            raise InputError(
                f'shutter is "{shutter.direction}", but camera_from_world is one pose; give the '
                "pair (start, end)"
            )
        return to_matrix(camera_from_world)
    if shutter is None:
        raise InputError(
            "camera_from_world is a pair of poses, but there is no rolling shutter; give "
            'shutter="top_to_bottom" or another direction, or one pose'
        )
    start, end = (to_matrix(pose) for pose in camera_from_world)
    return _core.CameraMotion(start, end, shutter)


def place_about(
    place: np.ndarray | _core.CameraMotion, origin: np.ndarray
) -> np.ndarray | _core.CameraMotion:
    """Places a camera in coordinates whose zero is `origin` (3,), as Gaussians' means are.

    Args:
        place: from `read_motion`, in world coordinates.
        origin: (3,) float64; with -origin the place comes back.
    """
    if not origin.any():
        return place
    if isinstance(place, _core.CameraMotion):
        start, end = (np.asarray(place_about(pose, origin)) for pose in (place.start, place.end))
        return _core.CameraMotion(start, end, place.shutter)
    moved = np.array(place, np.float64)
    moved[:3, 3] += moved[:3, :3] @ origin
    return moved


def convert_about_camera(
    gaussians: Any, place: np.ndarray | _core.CameraMotion, dtype: str = "float32"
) -> Any:
    """Converts Gaussians in float64 to float32, their means relative to the camera's centre.

    Args:
        gaussians: returned as they are if they are float32 or in a file.
        place: from `read_motion`, in world coordinates.
        dtype: "float64": the Gaussians are returned as they are.
    """
    if dtype != "float32" or getattr(gaussians, "dtype", None) != np.float64:
        return gaussians
    pose = np.asarray(place.start if isinstance(place, _core.CameraMotion) else place)
    center = -pose[:3, :3].T @ pose[:3, 3]
    return gaussians.with_origin(center).to_dtype(np.float32)


def _is_pair(camera_from_world: Any) -> bool:
    if isinstance(camera_from_world, np.ndarray):
        return camera_from_world.ndim == 3 and len(camera_from_world) == 2
    if not isinstance(camera_from_world, Sequence) or len(camera_from_world) != 2:
        return False
    return to_matrix(camera_from_world[0]).ndim == 2
