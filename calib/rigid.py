"""Rigid transforms as six numbers: Rodrigues rotation (3), then translation (3)."""

from __future__ import annotations

import numpy as np

_SMALL_ANGLE = 1e-8  # radians: below it sin(a)/a and (1 - cos a)/a^2 are their limits in double


def skew(vectors: np.ndarray) -> np.ndarray:
    """(..., 3) -> (..., 3, 3): the matrix of the cross product with each vector."""
    v = np.asarray(vectors, float)
    cross = np.zeros((*v.shape, 3))
    for axis, (first, second) in enumerate(((2, 1), (0, 2), (1, 0))):
        cross[..., first, second] = v[..., axis]
        cross[..., second, first] = -v[..., axis]
    return cross


def rotation_matrix(rodrigues: np.ndarray) -> np.ndarray:
    """(3,) -> (3, 3), Rodrigues' formula."""
    rodrigues = np.asarray(rodrigues, float)
    angle = np.linalg.norm(rodrigues)
    cross = skew(rodrigues)
    if angle < _SMALL_ANGLE:
        return np.eye(3) + cross
    half = np.sin(angle / 2) / angle
    return np.eye(3) + np.sin(angle) / angle * cross + 2 * half**2 * cross @ cross


def rodrigues_vector(rotation: np.ndarray) -> np.ndarray:
    """(3, 3) -> (3,), through the quaternion: exact for all angles up to half a turn."""
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
    """Applies six numbers to points (..., 3)."""
    pose = np.asarray(target_from_source, float)
    return points @ rotation_matrix(pose[:3]).T + pose[3:]


def compose(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The transform that applies b, then a."""
    rotation = rotation_matrix(a[:3])
    return np.concatenate(
        [
            rodrigues_vector(rotation @ rotation_matrix(b[:3])),
            rotation @ np.asarray(b[3:], float) + np.asarray(a[3:], float),
        ]
    )


def inverse(pose: np.ndarray) -> np.ndarray:
    """The transform back."""
    rotation = rotation_matrix(pose[:3]).T
    return np.concatenate([rodrigues_vector(rotation), -rotation @ np.asarray(pose[3:], float)])


def rotation_angle(a: np.ndarray, b: np.ndarray) -> float:
    """Radians between two rotation matrices."""
    return float(np.linalg.norm(rodrigues_vector(np.asarray(a) @ np.asarray(b).T)))
