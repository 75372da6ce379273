"""What is known of a focal length beside the pictures: a value with a width."""

from __future__ import annotations

import dataclasses


@dataclasses.dataclass(frozen=True)
class FocalPrior:
    """A focal length that a camera, a database or a user states.

    Attributes:
        px: focal length in pixels.
        sigma: standard deviation of its natural logarithm.
        source: who states it, for messages: "EXIF".
    """

    px: float
    sigma: float
    source: str

    def scale(self, factor: float) -> FocalPrior:
        """Returns the prior of pictures resized by a factor."""
        return dataclasses.replace(self, px=factor * self.px)
