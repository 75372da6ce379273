"""Rotates, scales and moves Gaussians as a whole; their harmonics rotate with them."""

from __future__ import annotations

import dataclasses

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.bounds import LEAST_SCALE, check_direction, check_number, check_vector, name_wrong_kinds
from gsut.gaussians.arrays import Gaussians
from gsut.gaussians.quaternions import multiply_quaternions, quaternion_from_rotation

# Directions at which rotated harmonics are fitted; 16 coefficients need at least 16.
_DIRECTIONS = 64
# Largest deviation of a rotation from an orthogonal matrix: files often hold six digits.
_ORTHOGONAL = 1e-6
# Up in viewers, whose y axis points down.
_UP = np.array([0.0, -1.0, 0.0])


@name_wrong_kinds
def transform_gaussians(
    gaussians: Gaussians,
    rotation: np.typing.ArrayLike,
    scale: float = 1.0,
    translation: np.typing.ArrayLike = (0.0, 0.0, 0.0),
) -> Gaussians:
    """Applies x -> scale rotation x + translation to Gaussians, in world coordinates.

    Args:
        gaussians: N Gaussians.
        rotation: (3, 3), orthogonal and right-handed to 1e-6.
        scale: from 1e-12 to 1e12.
        translation: (3,), in the new units.

    Returns:
        Gaussians that give the same picture to a camera moved the same way; the origin moves too.

    Raises:
        InputError: `rotation` is no rotation, or the scale or the translation is out of range.
    """
    r = np.asarray(rotation, np.float64)
    proper = r.shape == (3, 3) and bool((np.abs(r) < 2).all())
    proper = proper and np.allclose(r @ r.T, np.eye(3), atol=_ORTHOGONAL)
    if not proper or np.linalg.det(r) < 0:
        raise InputError(f"a rotation and a scale above 0 are needed, found {r.tolist()}")
    scale = check_number(scale, "scale", LEAST_SCALE, 1 / LEAST_SCALE)
    shift, g = check_vector(translation, "translation"), gaussians
    return dataclasses.replace(
        g,
        means=(scale * (g.means.astype(np.float64) @ r.T)).astype(g.dtype),
        quats=multiply_quaternions(quaternion_from_rotation(r), g.quats.astype(np.float64)).astype(
            g.dtype
        ),
        log_scales=(g.log_scales + np.log(scale)).astype(g.dtype),
        sh=np.einsum("ij,njc->nic", rotate_harmonics(g.sh_degree, r), g.sh).astype(g.dtype),
        origin=scale * (r @ g.origin) + shift,
    )


def rotate_harmonics(degree: int, rotation: np.ndarray) -> np.ndarray:
    """Computes the matrix (K, K) float64 that rotates the harmonics' coefficients.

    A least-squares fit to values at some directions is exact, as rotations keep each degree.
    """
    number = np.arange(_DIRECTIONS) + 0.5
    z, angle = 1 - 2 * number / _DIRECTIONS, np.pi * (1 + np.sqrt(5.0)) * number
    radius = np.sqrt(1 - z * z)
    directions = np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)
    after = _core.harmonics_basis(degree, directions)
    before = _core.harmonics_basis(degree, directions @ rotation)
    return np.linalg.lstsq(after, before, rcond=None)[0]


@name_wrong_kinds
def rotate_upright(up: np.typing.ArrayLike) -> np.ndarray:
    """Returns the shortest rotation that takes a direction to -y, which is up in viewers.

    Args:
        up: (3,), any length but 0.

    Returns:
        (3, 3), for `transform_gaussians`.

    Raises:
        InputError: it is no direction.
    """
    direction = check_direction(up, "up")
    axis, cosine = np.cross(direction, _UP), float(direction @ _UP)
    if cosine < -1 + 1e-9:  # opposite: half a turn about any horizontal axis, here x
        return np.diag([1.0, -1.0, -1.0])
    # Rodrigues' formula, of an axis as long as the angle's sine.
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + cross + cross @ cross / (1 + cosine)
