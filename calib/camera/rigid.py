"""Composes rigid transforms stored as six numbers: Rodrigues rotation (3), translation (3)."""

from __future__ import annotations

import numpy as np

# Radians: below, sin(a)/a and (1 - cos a)/a^2 equal their limits in double precision.
_SMALL_ANGLE = 1e-8


def cross_matrix_from_vector(vectors: np.ndarray) -> np.ndarray:
    """Returns the matrices (..., 3, 3) of the cross product with each vector (..., 3)."""
    v = np.asarray(vectors, float)
    cross = np.zeros((*v.shape, 3))
    for axis, (first, second) in enumerate(((2, 1), (0, 2), (1, 0))):
        cross[..., first, second] = v[..., axis]
        cross[..., second, first] = -v[..., axis]
    return cross


def matrix_from_rodrigues(rodrigues: np.ndarray) -> np.ndarray:
    """Returns the rotation matrix (3, 3) of a Rodrigues vector (3,)."""
    rodrigues = np.asarray(rodrigues, float)
    angle = np.linalg.norm(rodrigues)
    cross = cross_matrix_from_vector(rodrigues)
    if angle < _SMALL_ANGLE:
        return np.eye(3) + cross
    half = np.sin(angle / 2) / angle
    return np.eye(3) + np.sin(angle) / angle * cross + 2 * half**2 * cross @ cross


def rodrigues_from_matrix(rotation: np.ndarray) -> np.ndarray:
    """Returns the Rodrigues vector of a rotation matrix; exact for angles up to half a turn.

    It goes through the quaternion, computed from the largest of its four entries.
    """
    r = np.asarray(rotation, float)
    four = np.array(
        [
            1 + r[0, 0] + r[1, 1] + r[2, 2],
            1 + r[0, 0] - r[1, 1] - r[2, 2],
            1 - r[0, 0] + r[1, 1] - r[2, 2],
            1 - r[0, 0] - r[1, 1] + r[2, 2],
        ]
    )
    dx, dy, dz = r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]
    xy, xz, yz = r[0, 1] + r[1, 0], r[0, 2] + r[2, 0], r[1, 2] + r[2, 1]
    quaternions = [
        (four[0], dx, dy, dz),
        (dx, four[1], xy, xz),
        (dy, xy, four[2], yz),
        (dz, xz, yz, four[3]),
    ]
    w, x, y, z = np.array(quaternions[int(np.argmax(four))])
    axis = np.array([x, y, z]) * (1.0 if w >= 0 else -1.0)
    length = np.linalg.norm(axis)
    if length < _SMALL_ANGLE * abs(w):
        return 2 * axis / abs(w)
    return 2 * np.arctan2(length, abs(w)) * axis / length


def transform_points(target_from_source: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Applies a rigid transform to points (..., 3)."""
    pose = np.asarray(target_from_source, float)
    return points @ matrix_from_rodrigues(pose[:3]).T + pose[3:]


def compose(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Composes two transforms into the one that applies b, then a."""
    rotation = matrix_from_rodrigues(a[:3])
    return np.concatenate(
        [
            rodrigues_from_matrix(rotation @ matrix_from_rodrigues(b[:3])),
            rotation @ np.asarray(b[3:], float) + np.asarray(a[3:], float),
        ]
    )


def invert(pose: np.ndarray) -> np.ndarray:
    """Inverts a rigid transform."""
    rotation = matrix_from_rodrigues(pose[:3]).T
    return np.concatenate(
        [rodrigues_from_matrix(rotation), -rotation @ np.asarray(pose[3:], float)]
    )


def measure_rotation_angle(a: np.ndarray, b: np.ndarray) -> float:
    """Measures the radians between two rotation matrices."""
    return float(np.linalg.norm(rodrigues_from_matrix(np.asarray(a) @ np.asarray(b).T)))
