"""Pictures as bytes and as PNG files, whole or not at all."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.bounds import name_wrong_kinds
from gsut.files import claim_name, write_file
from gsut.orientation import add_orientation


@name_wrong_kinds
def to_uint8(image: np.ndarray) -> np.ndarray:
    """Converts colours to bytes, ready to be written.

    Args:
        image: floating point, in [0, 1]; values outside are clipped, NaN becomes 0.

    Returns:
        uint8 of the same shape, rounded.
    """
    inside = np.fmin(np.fmax(image, 0.0), 1.0)  # of NaN and a number fmax takes the number
    return np.rint(inside * 255.0).astype(np.uint8)


@name_wrong_kinds
def write_png(path: Path, image: np.ndarray, turns: int = 0) -> None:
    """Writes a picture as PNG.

    Args:
        path: the file; replaced where it exists.
        image: (H, W, 3) red, green, blue, or (H, W); uint8 or uint16.
        turns: quarter turns clockwise that show it upright, which EXIF in the file then says.

    Raises:
        InputError: other pixels, or the file cannot be written.
    """
    import cv2

    pixels = np.ascontiguousarray(_core.read_array(image, "image"))
    if pixels.dtype not in (np.uint8, np.uint16) or pixels.shape[2:] not in ((), (3,)):
        raise InputError(
            f"image must be (H, W, 3) or (H, W) of uint8 or uint16, found {pixels.dtype} of shape "
            f"{pixels.shape}"
        )
    if pixels.ndim == 3:
        pixels = cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR)
    _, data = cv2.imencode(".png", pixels)
    write_file(path, add_orientation(data.tobytes(), turns))


def name_pictures(names: Sequence[str]) -> list[str]:
    """Names files for views, without extension: folders become _, and no two are the same."""
    stems: list[str] = []
    taken: set[str] = set()
    for name in names:
        stem = Path(name).with_suffix("").as_posix().strip("/.").replace("/", "_") or "view"
        stems.append(claim_name(stem, taken))
    return stems
