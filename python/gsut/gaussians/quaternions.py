"""Rotations as matrices and quaternions w, x, y, z: conversions, products, nearest ones."""

from __future__ import annotations

import numpy as np

_TINY = 1e-12  # twice the sine of a turn that has no axis


def quaternion_from_rotation(rotation: np.ndarray) -> np.ndarray:
    """Converts rotations (..., 3, 3) to quaternions (..., 4) w, x, y, z with w >= 0.

    Takes the eigenvector of the largest eigenvalue of Bar-Itzhack's matrix (2000), which is stable
    for all rotations.
    """
    r = np.moveaxis(rotation, (-2, -1), (0, 1))
    rows = [
        [r[0, 0] + r[1, 1] + r[2, 2], r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]],
        [r[2, 1] - r[1, 2], r[0, 0] - r[1, 1] - r[2, 2], r[0, 1] + r[1, 0], r[0, 2] + r[2, 0]],
        [r[0, 2] - r[2, 0], r[0, 1] + r[1, 0], r[1, 1] - r[0, 0] - r[2, 2], r[1, 2] + r[2, 1]],
        [r[1, 0] - r[0, 1], r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], r[2, 2] - r[0, 0] - r[1, 1]],
    ]
    vectors = np.linalg.eigh(np.moveaxis(np.array(rows), (0, 1), (-2, -1)))[1][..., -1]
    return np.where(vectors[..., :1] >= 0, vectors, -vectors)


def multiply_quaternions(q: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Multiplies one quaternion (4,) from the left with others (N, 4)."""
    w, x, y, z = q
    left = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
    return others @ left.T.astype(others.dtype)


def rotations_from_quaternions(q: np.ndarray) -> np.ndarray:
    """Converts unit quaternions (N, 4) to rotations (N, 3, 3)."""
    w, x, y, z = q.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=1) for row in rows], axis=1)


def find_nearest_rotation(matrices: np.ndarray) -> np.ndarray:
    """Finds the rotations nearest to matrices (..., 3, 3), never a reflection.

    Of a sum of b a^T that is the rotation which carries directions a best to b; of a sum of
    rotations their mean (Kabsch, "A solution for the best rotation to relate two sets of vectors",
    1976).
    """
    left, _, right = np.linalg.svd(matrices)
    left[..., -1] *= np.sign(np.linalg.det(left @ right))[..., None]
    return left @ right


def find_rotation_vectors(rotations: np.ndarray) -> np.ndarray:
    """Finds the rotation vectors (N, 3) of rotations (N, 3, 3) of less than half a turn."""
    axes, sine, angle = _split_rotations(rotations)
    return axes * np.where(sine > _TINY, angle / np.maximum(sine, _TINY), 0.5)[:, None]


def measure_rotation_angles(rotations: np.ndarray) -> np.ndarray:
    """Returns (N,) the angles in radians of rotations (N, 3, 3), exact for small ones too."""
    return _split_rotations(rotations)[2]


def _split_rotations(rotations: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns axes (N, 3) of the length of twice the sine, that length and the angle (N,)."""
    axes = np.stack(
        [
            rotations[:, 2, 1] - rotations[:, 1, 2],
            rotations[:, 0, 2] - rotations[:, 2, 0],
            rotations[:, 1, 0] - rotations[:, 0, 1],
        ],
        axis=1,
    )
    sine = np.linalg.norm(axes, axis=1)
    return axes, sine, np.arctan2(sine, np.trace(rotations, axis1=1, axis2=2) - 1)
