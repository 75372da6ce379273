"""Makes surfels (2DGS): Gaussians that are thin discs, with the third axis as normal.

The largest response of a Gaussian along a ray becomes, as its third scale goes to nothing, that at
the ray's intersection with the disc's plane (Huang et al., "2D Gaussian splatting", 2024, eqs. 8 to
10). A ten-thousandth of the shorter scale is thin enough, in float too, so surfels need no kernels
of their own.
"""

from __future__ import annotations

import numpy as np

from gsut._core import SURFEL_LOG_THICKNESS
from gsut.gaussians.quaternions import quaternion_from_rotation, rotations_from_quaternions

# Rounding of log scales that a common factor was added to.
_ROUNDING = 1e-3


def press_surfels(log_scales: np.ndarray) -> None:
    """Sets the third scale (N, 3) to a ten-thousandth of the shorter of the others, in place."""
    shorter = np.minimum(log_scales[:, 0], log_scales[:, 1])
    log_scales[:, 2] = shorter + log_scales.dtype.type(SURFEL_LOG_THICKNESS)


def are_pressed(log_scales: np.ndarray) -> bool:
    """Returns whether every third scale is a ten-thousandth of the shorter of the others."""
    thin = np.minimum(log_scales[:, 0], log_scales[:, 1]) + SURFEL_LOG_THICKNESS
    return len(log_scales) > 0 and bool(np.all(np.abs(log_scales[:, 2] - thin) < _ROUNDING))


def press_shortest(quats: np.ndarray, log_scales: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Makes the shortest axis the third: returns quaternions (N, 4) and pressed scales (N, 3)."""
    axis = 2 - np.argmin(log_scales[:, ::-1], axis=1)  # of equal ones the third
    order = (axis[:, None] + np.array([1, 2, 3])) % 3
    scales = np.take_along_axis(log_scales, order, axis=1)
    press_surfels(scales)
    quats = quats.copy()
    turned = np.flatnonzero(axis != 2)
    unit = quats[turned] / np.linalg.norm(quats[turned], axis=1, keepdims=True)
    axes = np.take_along_axis(rotations_from_quaternions(unit), order[turned][:, None], axis=2)
    quats[turned] = quaternion_from_rotation(axes)
    return quats, scales
