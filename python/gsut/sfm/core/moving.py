"""What is known of images that are read line by line, where the camera's motion is known."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from gsut._core import Shutter


@dataclasses.dataclass(frozen=True)
class Moving:
    """What `refine` knows of images that are read line by line.

    Args:
        shutter: the order of the lines.
        readout: seconds from the first line to the last.
        rates: (N, 6) velocities in a second (see Solution.velocities); NaN: not known.
        sigma: share of them that images' own velocities differ by.
        extend: tracks are extended at the end.
    """

    shutter: Shutter
    readout: float
    rates: np.ndarray
    sigma: float = 0.1
    extend: bool = True

    def as_settings(self) -> dict[str, Any]:
        """As the solver takes it."""
        return {
            "shutter": self.shutter.direction, "readout_time": self.readout,
            "image_rates": self.rates.tolist(), "rate_sigma": self.sigma,
        }  # fmt: skip
