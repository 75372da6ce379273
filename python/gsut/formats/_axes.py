"""Between axes with y down (OpenCV, photographs) and y up (glTF, USD): half a turn about z."""

from __future__ import annotations

import numpy as np

from gsut.gaussians import Gaussians

_AXES = np.array([-1.0, -1.0, 1.0], np.float32)


def half_turned(gaussians: Gaussians) -> Gaussians:
    """Turned by 180 degrees about z, exactly; twice is nothing.

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
    )
