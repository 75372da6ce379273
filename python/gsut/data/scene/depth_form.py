"""States how the numbers of a depth file are meant."""

from __future__ import annotations

import dataclasses
from pathlib import Path

MILLIMETRE = 1e-3  # metres of a level of a 16-bit depth picture, as RGB-D cameras write it


@dataclasses.dataclass(frozen=True)
class DepthForm:
    """How a view's depth file is read.

    Attributes:
        unit: world units of a level of integer pictures; other files hold world units.
        is_z: whether depths are measured along the camera's axis, not along each pixel's ray.
        confidence_path: picture of how sure the sensor is of each depth, or None.
        least_confidence: level of it from which a depth is used.
    """

    unit: float = MILLIMETRE
    is_z: bool = False
    confidence_path: Path | None = None
    least_confidence: int = 1


DISTANCES = DepthForm()  # along the rays, in millimetres or world units
