"""Makes surfels (2DGS): Gaussians that are thin discs, with the third axis as normal.

The largest response of a Gaussian along a ray becomes, as its third scale goes to nothing, that at
the ray's intersection with the disc's plane (Huang et al., "2D Gaussian splatting", 2024, eqs. 8 to
10). A ten-thousandth of the shorter scale is thin enough, in float too, so surfels need no kernels
of their own.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from gsut._core import SURFEL_LOG_THICKNESS
from gsut.gaussians.arrays import Gaussians
from gsut.gaussians.quaternions import quaternion_from_rotation, rotations_from_quaternions

# Rounding of log scales that a common factor was added to.
_ROUNDING = 1e-3


def press_surfels(log_scales: np.ndarray) -> None:
    """Sets the third scale (N, 3) to a ten-thousandth of the shorter of the others, in place."""
    shorter = np.minimum(log_scales[:, 0], log_scales[:, 1])
    log_scales[:, 2] = shorter + log_scales.dtype.type(SURFEL_LOG_THICKNESS)


def are_surfels(gaussians: Gaussians) -> bool:
    """Returns whether every third scale is a ten-thousandth of the shorter of the others."""
    scales = gaussians.log_scales
    thin = np.minimum(scales[:, 0], scales[:, 1]) + SURFEL_LOG_THICKNESS
    return len(scales) > 0 and bool(np.all(np.abs(scales[:, 2] - thin) < _ROUNDING))


def to_surfels(gaussians: Gaussians) -> Gaussians:
    """Flattens Gaussians: the shortest axis becomes the normal, and its scale is dropped.

    Args:
        gaussians: N Gaussians of any scales.

    Returns:
        N surfels of the same dtype; arrays that do not change are not copied.
    """
    axis = 2 - np.argmin(gaussians.log_scales[:, ::-1], axis=1)  # of equal ones the third
    order = (axis[:, None] + np.array([1, 2, 3])) % 3
    scales = np.take_along_axis(gaussians.log_scales, order, axis=1)
    press_surfels(scales)
    quats = gaussians.quats.copy()
    turned = np.flatnonzero(axis != 2)
    unit = quats[turned] / np.linalg.norm(quats[turned], axis=1, keepdims=True)
    axes = np.take_along_axis(rotations_from_quaternions(unit), order[turned][:, None], axis=2)
    quats[turned] = quaternion_from_rotation(axes)
    return dataclasses.replace(gaussians, quats=quats, log_scales=scales)
