"""Weights of a training image's residuals: smaller where the lens is uncertain."""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np

from gsut._core import InputError
from gsut.lens.camera import Camera
from gsut.lens.uncertainty import load_uncertainty

# Standard deviation, in pixels of the image trained on, at which a residual counts half: one that
# comes from the neighbouring pixel as likely as from its own.
_HALF_SIGMA_PX = 1.0


class CalibrationWeights:
    """Multiplies the loss' gradient at each pixel by 1 / (1 + (sigma / 1 px)^2).

    sigma is the lens' standard deviation at that pixel, in pixels of the image trained on: at a
    coarse level the same lens is less uncertain. The weights change slowly over the image, so that
    SSIM's windows see nearly one weight each; the loss itself is reported without them.

    Args:
        path: lens file with its uncertainty, see `load_uncertainty`.
        cameras: of the scene.

    Raises:
        InputError: several cameras, images of another shape, or no uncertainty in the file.
        CalibrationError: not a lens file, or a broken one.
        OSError: the file cannot be read.
    """

    def __init__(self, path: str | os.PathLike[str], cameras: Sequence[Camera]) -> None:
        if len(cameras) != 1:
            raise InputError(
                f"--set calibration_weights takes the file of one lens, the data has "
                f"{len(cameras)} lenses; train without it"
            )
        try:
            self._uncertainty = load_uncertainty(path)
            self._uncertainty.resample(cameras[0].width, cameras[0].height)
        except InputError as error:
            raise type(error)(f"--set calibration_weights: {error}") from error
        self._of_size: dict[tuple[int, int], np.ndarray] = {}

    def resample(self, width: int, height: int) -> np.ndarray:
        """Returns float32 weights (height, width, 1) in (0, 1] for images of this size."""
        if (width, height) not in self._of_size:
            sigma = self._uncertainty.resample(width, height) / _HALF_SIGMA_PX
            self._of_size[width, height] = (1 / (1 + sigma**2)).astype(np.float32)[..., None]
        return self._of_size[width, height]

    def apply(self, dimage: np.ndarray) -> None:
        """Multiplies dloss_dimage (H, W, 3) in place."""
        dimage *= self.resample(dimage.shape[1], dimage.shape[0])
