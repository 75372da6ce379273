"""Which way up a picture is shown: EXIF's orientation, and quarter turns of pixels and cameras.

Pictures keep the pixels that the sensor saw, and lens and pose belong to them: photographs taken
upright and level then share one lens. What people look at is turned upright, by the same quarter
turns that any viewer of photographs takes from EXIF.
"""

from __future__ import annotations

import struct
import zlib

import numpy as np

# Orientations of EXIF that quarter turns clockwise make upright; mirrored ones turn as their twins.
_TURNS = {3: 2, 4: 2, 5: 1, 6: 1, 7: 3, 8: 3}
# EXIF's orientation of a picture that is upright after this number of turns.
ORIENTATIONS = (1, 6, 3, 8)
# Orientations of pictures whose pixels are mirrored: that of the same pixels, mirrored left-right.
UNMIRRORED = {2: 1, 4: 3, 5: 8, 7: 6}
ORIENTATION_TAG = 0x0112  # of EXIF
_SHORT = 3  # TIFF's type of two bytes
EXIF_HEADER = b"Exif\0\0"
_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_PNG_HEADER_END = 33  # bytes of the signature and the first chunk


def count_turns(orientation: int) -> int:
    """Counts the quarter turns clockwise that show a picture of EXIF's orientation upright."""
    return _TURNS.get(orientation, 0)


def read_orientation(tiff: bytes) -> int:
    """Reads the orientation of an EXIF block; 1, upright, if it has none or is damaged."""
    from PIL import Image  # here, because gsut --help needs none

    exif = Image.Exif()
    try:
        exif.load(tiff)
        value = exif.get(ORIENTATION_TAG, 1)
    except (LookupError, OSError, SyntaxError, TypeError, ValueError, struct.error):
        return 1
    return int(value) if value in range(1, 9) else 1


def add_orientation(data: bytes, turns: int) -> bytes:
    """Adds to a JPEG or PNG the EXIF orientation that these quarter turns make upright.

    Args:
        data: of the file, without EXIF.
        turns: clockwise; 0 changes nothing.
    """
    if not turns % 4:
        return data
    entry = struct.pack("<HHIHH", ORIENTATION_TAG, _SHORT, 1, ORIENTATIONS[turns % 4], 0)
    tiff = b"II*\0" + struct.pack("<IH", 8, 1) + entry + bytes(4)
    if data.startswith(_PNG_SIGNATURE):
        chunk = b"eXIf" + tiff
        part = struct.pack(">I", len(tiff)) + chunk + struct.pack(">I", zlib.crc32(chunk))
        return data[:_PNG_HEADER_END] + part + data[_PNG_HEADER_END:]
    block = EXIF_HEADER + tiff
    return data[:2] + b"\xff\xe1" + struct.pack(">H", len(block) + 2) + block + data[2:]


def turn_picture(pixels: np.ndarray, turns: int) -> np.ndarray:
    """Turns pixels (H, W, ...) clockwise by quarter turns."""
    return np.ascontiguousarray(np.rot90(pixels, -turns)) if turns % 4 else pixels


def turn_camera(camera_from_world: np.ndarray, turns: int) -> np.ndarray:
    """Turns poses (..., 4, 4) of a camera to those of its picture after `turn_picture`, exactly."""
    x, y = camera_from_world[..., 0, :], camera_from_world[..., 1, :]
    first, second = ((x, y), (-y, x), (-x, -y), (y, -x))[turns % 4]
    turned = np.array(camera_from_world, np.float64)
    turned[..., 0, :], turned[..., 1, :] = first, second
    return turned


def turn_pixel(x: float, y: float, width: int, height: int, turns: int) -> tuple[float, float]:
    """Returns where a point of a picture of this size is after `turn_picture`."""
    places = ((x, y), (height - y, x), (width - x, height - y), (y, width - x))
    return places[turns % 4]


def turn_size(width: int, height: int, turns: int) -> tuple[int, int]:
    """Returns the size of a picture after `turn_picture`."""
    return (height, width) if turns % 2 else (width, height)
