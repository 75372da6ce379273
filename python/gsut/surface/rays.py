"""Lines of sight of a view's pixels in the world, through any lens and shutter."""

from __future__ import annotations

from typing import Any

import numpy as np

from gsut._core import CameraMotion


def cast_world_rays(
    camera: Any, motion: np.ndarray | CameraMotion
) -> tuple[np.ndarray, np.ndarray]:
    """Returns origins and unit rays (H, W, 3) of the pixels in the world; NaN without a ray.

    Args:
        camera: the lens; it may have no one centre.
        motion: (4, 4) camera_from_world, or a rolling shutter's: then each line has its own.
    """
    rays, _ = camera.rays()
    origins, world = np.empty_like(rays), np.empty_like(rays)
    lines: list[tuple[Any, np.ndarray]] = [(slice(None), np.asarray(motion))]
    if isinstance(motion, CameraMotion):
        times = motion.shutter.line_times(camera.width, camera.height)
        over_rows = "left" not in motion.shutter.direction
        lines = [
            ((line if over_rows else (slice(None), line)), motion.at(time))
            for line, time in enumerate(times)
        ]
    for where, pose in lines:
        rotation, shift = pose[:3, :3], pose[:3, 3]
        origins[where] = (camera.origins()[where] - shift) @ rotation
        world[where] = rays[where] @ rotation
    return origins, world


def cast_onto(
    tree: Any, camera: Any, motion: np.ndarray | CameraMotion
) -> tuple[np.ndarray, np.ndarray]:
    """Casts a view's rays onto the triangles of a tree.

    Returns:
        Distances (H, W), NaN without a hit, and the numbers of the triangles, then -1.
    """
    origins, world = cast_world_rays(camera, motion)
    flat = np.ascontiguousarray(origins.reshape(-1, 3)), np.ascontiguousarray(world.reshape(-1, 3))
    distances, faces = tree.cast(*flat)
    return distances.reshape(world.shape[:2]), faces.reshape(world.shape[:2])
