"""Derives a focal length in pixels, with its width, from what a camera wrote."""

from __future__ import annotations

import dataclasses
import math

from gsut.judge import SURE
from gsut.lens import FocalPrior

# Diagonal in mm of the 36 x 24 mm frame that "35 mm equivalent" refers to.
_FRAME_DIAGONAL = math.hypot(36.0, 24.0)
# Diagonals in mm and aspect ratios of sensors: full frame, APS-C, four thirds, one inch, and the
# smaller ones of phones, drones and compact cameras.
_SENSORS = ((43.3, 1.5), (27.5, 1.5), (21.6, 4 / 3), (15.9, 1.5), (7.0, 4 / 3))
# Standard deviation of the logarithm: cameras write nominal focal lengths of distant focus, and
# equivalents by the diagonal or by the width, which differ by 4 % on a sensor of 4:3.
_NOMINAL = 0.05
# Standard deviation in mm of a value rounded to whole millimetres.
_ROUNDED = 1 / math.sqrt(12)
# Standard deviation of the logarithm where a picture was cropped by an unknown amount.
_CROPPED = 0.15
# Relative difference of aspect ratios that rounding and resizing explain.
SAME_SHAPE = 0.01
# Aspect ratio from which a picture was cropped: sensors of photographs are 4:3 or 3:2.
_WIDE = 1.6
# Focal lengths over the longer side of the picture that no camera exceeds.
_RANGE = 0.12, 60.0


@dataclasses.dataclass(frozen=True)
class FocalStatement:
    """What a camera wrote about its focal length.

    Attributes:
        focal_mm: of the lens.
        equivalent_mm: of a 36 x 24 mm frame with the same view.
        pixels_per_mm: of the sensor, at the original size.
        zoom: digital zoom.
        original: width and height of the picture as it was taken; None: as it is.
    """

    focal_mm: float | None = None
    equivalent_mm: float | None = None
    pixels_per_mm: float | None = None
    zoom: float = 1.0
    original: tuple[int, int] | None = None


def find_focal_prior(
    stated: FocalStatement, width: int, height: int
) -> tuple[FocalPrior | None, list[str]]:
    """Finds the focal length in pixels of a picture of this size.

    The 35 mm equivalent compares the diagonals of whole sensors: a picture of another shape than
    its sensor was cropped.

    Returns:
        The focal length, None if it is not known, and notes on what was not believed.
    """
    scale, scale_sigma = _find_scale(stated.original, width, height)
    original = stated.original or (width, height)
    found = []
    if stated.focal_mm and stated.pixels_per_mm:
        px = scale * stated.zoom * stated.focal_mm * stated.pixels_per_mm
        found.append(FocalPrior(px, math.hypot(_NOMINAL, scale_sigma), "EXIF"))
    if stated.equivalent_mm:
        diagonal, crop_sigma = _find_sensor_diagonal(stated, *original)
        sigma = math.hypot(
            _NOMINAL, scale_sigma, crop_sigma, _ROUNDED / stated.equivalent_mm,
            math.log(stated.zoom) / 2,  # some cameras include the zoom, others do not
        )  # fmt: skip
        px = scale * stated.equivalent_mm / _FRAME_DIAGONAL * diagonal
        found.append(FocalPrior(px, sigma, "EXIF"))
    longer = max(width, height)
    likely = [prior for prior in found if _RANGE[0] <= prior.px / longer <= _RANGE[1]]
    notes = [
        f"the focal length in EXIF, {prior.px:.0f} px at {width} x {height}, is that of no lens "
        "and is not used"
        for prior in found if prior not in likely
    ]  # fmt: skip
    if len(likely) < 2:
        return (likely[0] if likely else None), notes
    first, second = likely
    gap = abs(math.log(first.px / second.px))
    if gap <= SURE * math.hypot(first.sigma, second.sigma):
        return min(likely, key=lambda prior: prior.sigma), notes
    notes.append(
        f"EXIF contradicts itself: a focal length of {first.px:.0f} px by the sensor's pixels, "
        f"{second.px:.0f} px by the 35 mm equivalent"
    )
    middle = math.sqrt(first.px * second.px)
    return FocalPrior(middle, math.hypot(gap / 2, _NOMINAL), "EXIF"), notes


def _find_scale(original: tuple[int, int] | None, width: int, height: int) -> tuple[float, float]:
    """Returns the scale of a resized picture, and the standard deviation of its logarithm."""
    if original is None:
        return 1.0, 0.0
    if (original[0] < original[1]) != (width < height):
        original = original[1], original[0]
    across, down = width / original[0], height / original[1]
    if abs(across / down - 1) <= SAME_SHAPE:
        return math.sqrt(across * down), 0.0
    return max(across, down), _CROPPED  # cropped along one side, as far as is known


def _find_sensor_diagonal(stated: FocalStatement, width: int, height: int) -> tuple[float, float]:
    """Returns the sensor's diagonal in pixels of the original picture.

    Returns:
        The diagonal, and the standard deviation of its logarithm: cameras may refer to the crop.
    """
    own = math.hypot(width, height)
    longer, shorter = max(width, height), min(width, height)
    aspect = longer / shorter
    if stated.focal_mm and stated.equivalent_mm:
        diagonal = _FRAME_DIAGONAL * stated.focal_mm / stated.equivalent_mm
        shape = min(_SENSORS, key=lambda sensor: abs(math.log(sensor[0] / diagonal)))[1]
    else:
        shape = aspect if aspect < _WIDE else math.sqrt(2)  # between 4:3 and 3:2
    if abs(aspect / shape - 1) <= SAME_SHAPE:
        return own, 0.0
    whole = longer * math.hypot(1, 1 / shape) if aspect > shape else shorter * math.hypot(1, shape)
    return whole, math.log(whole / own) / 2
