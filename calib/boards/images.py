"""Reads photographs as 8-bit grey and rejects truncated files."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from calib.errors import BoardError
from gsut.files import read_bytes, register_reader

# First bytes of a format, and the mark that ends a complete file.
_END_MARKS = {b"\xff\xd8": b"\xff\xd9", b"\x89PNG": b"IEND"}
_IN_THE_LAST = 65536  # bytes to search for the mark: cameras may append data of their own


def _make_error(*said: object) -> BoardError:
    return BoardError("{}: {}; {}".format(*said))


@register_reader("photograph of a board", fails=_make_error)
def read_grey(path: Path) -> np.ndarray:
    """Reads an image file as (H, W) uint8 as stored: EXIF orientation is not applied.

    Raises:
        BoardError: the file cannot be opened, is no image, or is cut off.
    """
    data = read_bytes(path, fails=_make_error)
    for start, end in _END_MARKS.items():
        if data.startswith(start) and end not in data[-_IN_THE_LAST:]:
            raise BoardError(
                f"{path}: the image is cut off after {len(data)} bytes; copy the file again"
            )
    flags = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), flags) if data else None
    except cv2.error:
        image = None
    if image is None:
        raise BoardError(
            f"{path}: not a readable image ({len(data)} bytes); leave it out or copy it again"
        )
    return image
