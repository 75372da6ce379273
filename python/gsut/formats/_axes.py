"""Between axes with y down (OpenCV, photographs) and y up (glTF, USD): half a turn about z."""

from __future__ import annotations

import numpy as np

from gsut._core import InputError
from gsut.gaussians import Gaussians, find_nearest_rotation, transform_gaussians

_AXES = np.array([-1.0, -1.0, 1.0], np.float32)
_ALIKE = 1e-3  # relative difference of scales: of writers in float32


def turn_half(gaussians: Gaussians) -> Gaussians:
    """Turns Gaussians by 180 degrees about z, exactly; twice changes nothing.

    Harmonics of odd order change sign, and nothing else is mixed.
    """
    q = gaussians.quats
    turned = np.stack([-q[:, 3], -q[:, 2], q[:, 1], q[:, 0]], axis=1)
    orders = np.concatenate([np.arange(-degree, degree + 1) for degree in range(4)])
    signs = np.where(orders % 2 == 0, 1, -1)[: gaussians.sh.shape[1]].astype(np.float32)
    return Gaussians(
        gaussians.means * _AXES,
        turned,
        gaussians.log_scales,
        gaussians.opacity_logits,
        gaussians.sh * signs[:, None],
        gaussians.origin * _AXES,
        **gaussians.rule,
    )


def place_in_world(gaussians: Gaussians, matrix: np.ndarray, what: str) -> Gaussians:
    """Places the Gaussians of a node in the world.

    Args:
        gaussians: of the node.
        matrix: (4, 4), world <- node.
        what: the node, for errors.

    Raises:
        InputError: the matrix mirrors, or stretches one axis more than another.
    """
    linear = matrix[:3, :3]
    determinant = np.linalg.det(linear) if np.isfinite(matrix).all() else 0.0
    scale = np.cbrt(determinant)
    if not (determinant > 0 and np.allclose(linear @ linear.T / scale**2, np.eye(3), atol=_ALIKE)):
        raise InputError(
            f"{what} is moved by a transform that mirrors or stretches it; gsut reads files whose "
            "Gaussians are turned, moved and scaled alike in all directions"
        )
    if np.array_equal(matrix, np.eye(4)):
        return gaussians
    rotation = find_nearest_rotation(linear)
    return transform_gaussians(gaussians, rotation, float(scale), matrix[:3, 3])
