"""Measures how well two rays of posed cameras meet: angles to epipolar planes."""

from __future__ import annotations

import numpy as np

from gsut.lens import Camera

TINY = 1e-12  # keeps quotients finite, and is the length of a baseline without a direction
SAME_DEGREES = 5.0  # between turns of images that agree: several errors of a turn
MOMENTS = 16  # of a rolling readout at which poses are taken: neighbouring poses hardly differ


def measure_pixels_per_radian(camera: Camera) -> float:
    """Returns the pixels that a radian covers on the axis; of a panorama the mean."""
    place, valid = camera.project(np.array([[0.0, 0.0, 1.0], [1e-4, 0.0, 1.0], [0.0, 1e-4, 1.0]]))
    if not np.all(valid):
        return float(np.hypot(camera.width, camera.height)) / 2
    return float(np.mean(np.linalg.norm(place[1:] - place[0], axis=1))) / 1e-4


def measure_angular_errors(rays: np.ndarray, world_from_camera: np.ndarray) -> np.ndarray:
    """Measures by how many radians two rays miss each other or would meet behind a camera.

    Args:
        rays: (2, M, 3) in camera axes.
        world_from_camera: (2, M, 4, 4), or (2, M, 3, 4).

    Returns:
        (M,); NaN where there is no ray.
    """
    one, two = np.einsum("smij,smj->smi", world_from_camera[..., :3, :3], rays)
    base = world_from_camera[1, :, :3, 3] - world_from_camera[0, :, :3, 3]
    length = np.linalg.norm(base, axis=1)
    base = base / np.maximum(length, TINY)[:, None]
    first, second = compute_cross_products(base, one), compute_cross_products(base, two)
    sizes = [np.sqrt(np.einsum("mi,mi->m", normal, normal)) for normal in (first, second)]
    across = np.einsum("mi,mi->m", two, first) / np.maximum(np.hypot(*sizes), TINY)
    # Seen from further along the baseline a point lies at a larger angle to it.
    angles = [
        np.arctan2(size, np.einsum("mi,mi->m", base, ray))
        for size, ray in zip(sizes, (one, two), strict=True)
    ]
    behind = np.maximum(angles[0] - angles[1], 0.0) / np.sqrt(2)
    found = np.hypot(across, behind)
    still = length <= TINY
    if still.any():
        apart = np.linalg.norm(compute_cross_products(one[still], two[still]), axis=1)
        turned = np.arctan2(apart, np.einsum("mi,mi->m", one[still], two[still]))
        found[still] = turned / np.sqrt(2)
    return found


def compute_cross_products(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Returns the cross product of (M, 3), several times faster than np.cross for few rows."""
    x, y, z = a.T
    u, v, w = b.T
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=1)
