"""Reads a photograph's metadata: camera, focal length, orientation, time and place (EXIF)."""

from __future__ import annotations

import calendar
import contextlib
import dataclasses
import math
import time
from pathlib import Path
from typing import Any

from gsut._core import InputError
from gsut.files import check_regular

# Diagonal of the 36 x 24 mm frame that "35 mm equivalent" refers to.
_FRAME_DIAGONAL = math.hypot(36.0, 24.0)
_MILLIMETRES = {2: 25.4, 3: 10.0, 4: 1.0}  # of FocalPlaneResolutionUnit: inch, centimetre, ...
RAW_SUFFIXES = (".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".rw2", ".orf")
# EXIF tag of the directory with exposure and lens.
_DETAILS = 0x8769
# EXIF tag of the directory with the place.
_PLACE = 0x8825


@dataclasses.dataclass(frozen=True)
class PhotographFacts:
    """What is known of a photograph before it is decoded.

    Attributes:
        path: the file.
        width, height: of the stored pixels.
        mode: Pillow's name of the pixel format: "RGB", "L", "I;16", "CMYK" ...
        make, model: of the camera; empty if missing.
        focal_px: focal length in stored pixels; None if missing.
        orientation: EXIF's, 1 to 8: how the stored pixels are turned.
        time: seconds, of the camera's own clock; None if missing.
        place: latitude and longitude in degrees, altitude in metres; None if missing.
    """

    path: Path
    width: int
    height: int
    mode: str
    make: str = ""
    model: str = ""
    focal_px: float | None = None
    orientation: int = 1
    time: float | None = None
    place: tuple[float, float, float] | None = None

    @property
    def camera(self) -> str:
        """The make and model, without repeating the make."""
        make = self.make.split(" ")[0]
        return self.model if self.model.startswith(make) else f"{make} {self.model}".strip()


def read_facts(path: Path) -> PhotographFacts:
    """Reads the header of a photograph.

    Raises:
        InputError: the format is not known, or the header is damaged.
    """
    from PIL import Image

    if path.suffix.lower() in RAW_SUFFIXES:
        return _read_raw_facts(path)
    Image.MAX_IMAGE_PIXELS = None  # panoramas are no bombs
    try:
        with Image.open(check_regular(path)) as image:
            exif = image.getexif()
            size, mode = image.size, image.mode
            details, place = exif.get_ifd(_DETAILS), exif.get_ifd(_PLACE)
    except (OSError, SyntaxError, ValueError) as error:
        raise InputError(
            f"{path}: cannot be read as a photograph ({error}); copy it again, or export it as "
            "JPEG or PNG"
        ) from None
    orientation = exif.get(0x0112, 1)
    return PhotographFacts(
        path, *size, mode, _clean_text(exif.get(0x010F)), _clean_text(exif.get(0x0110)),
        _find_focal_px(details, *size),
        orientation if orientation in range(1, 9) else 1,
        _read_time(details), _read_place(place),
    )  # fmt: skip


def _read_raw_facts(path: Path) -> PhotographFacts:
    """Reads a raw file: its size by LibRaw, the rest if it is a TIFF, as DNG is."""
    import rawpy
    from PIL import Image, UnidentifiedImageError

    try:
        with rawpy.imread(str(path)) as raw:
            width, height = raw.sizes.width, raw.sizes.height
    except rawpy.LibRawError as error:
        raise InputError(
            f"{path}: cannot be read as a raw photograph ({error}); export it as JPEG"
        ) from None
    try:
        with Image.open(check_regular(path)) as image:
            exif = image.getexif()
            details, place = exif.get_ifd(_DETAILS), exif.get_ifd(_PLACE)
    except (OSError, SyntaxError, ValueError, UnidentifiedImageError):
        return PhotographFacts(path, width, height, "raw")
    return PhotographFacts(
        path, width, height, "raw", _clean_text(exif.get(0x010F)), _clean_text(exif.get(0x0110)),
        _find_focal_px(details, width, height), 1, _read_time(details), _read_place(place),
    )  # fmt: skip


def _clean_text(value: Any) -> str:
    return str(value or "").replace("\0", "").strip()


def _read_number(value: Any) -> float | None:
    with contextlib.suppress(TypeError, ValueError, ZeroDivisionError):
        number = float(value)
        if math.isfinite(number) and number > 0:
            return number
    return None


def _find_focal_px(details: dict[int, Any], width: int, height: int) -> float | None:
    """Returns the focal length by the 35 mm equivalent, which compares diagonals, or by pixel
    pitch."""
    equivalent = _read_number(details.get(0xA405))
    if equivalent is not None:
        return equivalent / _FRAME_DIAGONAL * math.hypot(width, height)
    focal, pitch = _read_number(details.get(0x920A)), _read_number(details.get(0xA20E))
    unit = _MILLIMETRES.get(details.get(0xA210, 2))
    if focal is None or pitch is None or unit is None:
        return None
    across = _read_number(details.get(0xA002)) or width  # the size that the pitch is of
    return focal * pitch / unit * width / across


def _read_time(details: dict[int, Any]) -> float | None:
    try:
        moment = time.strptime(_clean_text(details.get(0x9003)), "%Y:%m:%d %H:%M:%S")
    except ValueError:
        return None
    part = _clean_text(details.get(0x9291))
    return calendar.timegm(moment) + (float(f"0.{part}") if part.isdecimal() else 0.0)


def _read_place(tags: dict[int, Any]) -> tuple[float, float, float] | None:
    try:
        latitude, longitude = (
            sum(float(value) / 60**power for power, value in enumerate(tags[key])) for key in (2, 4)
        )
        altitude = float(tags.get(6, 0.0)) * (-1 if tags.get(5) in (1, b"\x01") else 1)
    except (KeyError, TypeError, ValueError, ZeroDivisionError):
        return None
    south, west = tags.get(1) == "S", tags.get(3) == "W"
    return (-latitude if south else latitude), (-longitude if west else longitude), altitude
