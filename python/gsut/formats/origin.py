"""Where a file's zero lies in the world: at the world's own, but for scenes too far from it."""

from __future__ import annotations

import numpy as np

from gsut.gaussians import Gaussians

# Files hold float32. Where it rounds world coordinates by more than this fraction of the scene's
# extent (a hundredth of a pixel), they are written about the Gaussians' origin.
ROUNDING = 1e-5


def for_file(gaussians: Gaussians) -> Gaussians:
    """The Gaussians in float32 as a file shall hold them.

    Returns:
        In world coordinates (origin 0) where float32 rounds them by at most `ROUNDING` of the
        extent (median distance from the median), or where they have no origin; else as they are. A
        format keeps the `origin` of what it gets here, and its reader gives it back.
    """
    if not gaussians.origin.any() or len(gaussians) == 0:
        return gaussians.astype(np.float32)
    middle = np.median(gaussians.means, axis=0)
    extent = np.median(np.linalg.norm(gaussians.means - middle, axis=1))
    rounding = np.spacing(np.float32(np.abs(gaussians.origin + middle).max())) / 2
    if rounding > ROUNDING * extent:
        return gaussians.astype(np.float32)
    return gaussians.about((0.0, 0.0, 0.0)).astype(np.float32)
