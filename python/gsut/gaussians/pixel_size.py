"""Measures how large the pixels of cameras are where Gaussians stand."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from gsut import _core

# Share of the image's size by which a point may lie outside and still count as seen.
_BORDER = 0.1


def compute_pixel_density(points: np.ndarray, camera: _core.Camera, pose: np.ndarray) -> np.ndarray:
    """Computes how many pixels an image spends on a unit of area across the ray.

    Args:
        points: (N, 3) float64, world coordinates.
        camera: the lens.
        pose: (4, 4) camera_from_world.

    Returns:
        (N,) pixels per unit of area; 0 at points outside the image and a tenth of it around.
    """
    density = np.zeros(len(points))
    in_camera = points @ pose[:3, :3].T + pose[:3, 3]
    size = np.array([camera.width, camera.height])
    places, valid = camera.project(in_camera)
    with np.errstate(invalid="ignore"):
        seen = valid & np.all((places > -_BORDER * size) & (places < (1 + _BORDER) * size), 1)
    if seen.any():
        slope, _ = camera.project_jacobian(in_camera[seen], with_params=False)
        # s1 s2 of a 2 x 3 matrix: the length of the cross product of its rows.
        here = np.linalg.norm(np.cross(slope[:, 0], slope[:, 1]), axis=1)
        density[seen] = np.nan_to_num(here, posinf=0.0)
    return density


def find_pixel_sizes(
    means: np.ndarray, cameras: Sequence[_core.Camera], camera_from_world: Any
) -> np.ndarray:
    """Finds the side of the finest pixel that sees each point, through the real lens.

    Args:
        means: (N, 3) world coordinates.
        cameras: C cameras.
        camera_from_world: (C, 4, 4), one a camera.

    Returns:
        (N,) float64 world units: 1 / sqrt(s1 s2), with s1 and s2 the singular values of the
        derivative of the pixel by the point, the smallest over all cameras whose image, and a tenth
        of it around, contains the point. Points that no camera sees get the largest of the others.
    """
    points = np.asarray(means, np.float64)
    density = np.zeros(len(points))  # pixels a unit of length, squared
    for camera, pose in zip(cameras, np.asarray(camera_from_world, np.float64), strict=True):
        density = np.maximum(density, compute_pixel_density(points, camera, pose))
    sizes = np.full(len(points), np.nan)
    known = density > 0
    sizes[known] = 1.0 / np.sqrt(density[known])
    sizes[~known] = sizes[known].max() if known.any() else 0.0
    return sizes
