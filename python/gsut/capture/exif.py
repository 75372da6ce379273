"""Reads a photograph's metadata: camera, focal length, orientation, time, place and view."""

from __future__ import annotations

import calendar
import math
import time
from pathlib import Path
from typing import Any

from gsut._core import InputError
from gsut.capture.facts import PhotographFacts, Place
from gsut.capture.focal import FocalStatement, find_focal_prior
from gsut.capture.xmp import find_up, read_gimbal_angles
from gsut.data.images import read_header
from gsut.files import FileError, check_regular, find_kind, open_image, register_reader
from gsut.orientation import ORIENTATION_TAG

_MILLIMETRES = {2: 25.4, 3: 10.0, 4: 1.0, 5: 1e-3}  # of FocalPlaneResolutionUnit
# EXIF tag of the directory with exposure and lens.
_DETAILS = 0x8769
# EXIF tag of the directory with the place.
_PLACE = 0x8825
# Characters of a camera's name that are kept.
_LONGEST_NAME = 64
# Focal lengths in mm that lenses have, of the real ones and of 35 mm equivalents.
_FOCAL_MM = 0.3, 5000.0
# Pixels per millimetre that sensors have.
_PIXELS_PER_MM = 10.0, 5000.0
# Pixels along a side of a picture.
_SIDE = 16, 1_000_000
# Altitudes in metres that pictures are taken at: the Dead Sea to a stratospheric balloon.
_ALTITUDE = -500.0, 60_000.0
# Errors of positions in metres: beyond, a position is none.
_ACCURACY = 0.001, 10_000.0
# Years of pictures by digital cameras.
_YEARS = range(1980, 2101)


@register_reader("facts of a photograph")
def read_facts(path: Path) -> PhotographFacts:
    """Reads the header of a photograph.

    Raises:
        InputError: the format is not known, or the header is damaged.
    """
    is_raw = find_kind(path) == "raw"
    size, mode = (_read_raw_size(path), "raw") if is_raw else (None, "")
    try:
        with open_image(path) as image:
            if size is None:
                size, mode = image.size, image.mode
            exif = image.getexif()
            tags = dict(exif)
            if image.format == "TIFF" and not is_raw:  # decoders turn its pixels upright
                tags.pop(ORIENTATION_TAG, None)
            return _Reading(tags, exif, image.info.get("xmp")).to_facts(path, size, mode)
    except FileError as error:
        if is_raw and size is not None:
            return PhotographFacts(path, *size, mode)  # only DNG and its like are TIFF
        note = f"the metadata is damaged and is not used ({error.what})"
        return PhotographFacts(
            path, *(size or _read_size(path, error)), mode or "RGB", notes=(note,)
        )


def _read_size(path: Path, error: FileError) -> tuple[int, int]:
    """Reads the size of a picture whose metadata Pillow takes for a damaged picture."""
    try:
        header = read_header(path)
    except InputError:
        raise InputError(
            f"{path}: cannot be read as a photograph ({error.what}); copy it again, or export it "
            "as JPEG or PNG"
        ) from None
    return header.width, header.height


def _read_raw_size(path: Path) -> tuple[int, int]:
    """Reads the size of a raw file by LibRaw."""
    import rawpy

    try:
        with rawpy.imread(str(check_regular(path))) as raw:
            return raw.sizes.width, raw.sizes.height
    except rawpy.LibRawError as error:
        raise InputError(
            f"{path}: cannot be read as a raw photograph ({error}); export it as JPEG"
        ) from None


class _Reading:
    """Values of a photograph's metadata, each bounded by what cameras can mean.

    Args:
        tags: of EXIF's main directory.
        exif: has the other directories.
        xmp: packet of XMP, or None.
    """

    def __init__(self, tags: dict[int, Any], exif: Any, xmp: Any) -> None:
        self._tags = tags
        self._details = exif.get_ifd(_DETAILS)
        self._gps = exif.get_ifd(_PLACE)
        self._xmp = xmp if isinstance(xmp, bytes | str) else None
        self._notes: list[str] = []

    def to_facts(self, path: Path, size: tuple[int, int], mode: str) -> PhotographFacts:
        """Returns the record of a photograph whose stored pixels have this size."""
        orientation = self._tags.get(ORIENTATION_TAG, 1)
        if orientation not in range(1, 9):
            orientation = 1
        stated = self._read_focal()
        focal, notes = find_focal_prior(stated, *size)
        self._notes += notes
        angles = read_gimbal_angles(self._xmp)
        return PhotographFacts(
            path, *size, mode, _clean_text(self._tags.get(0x010F)),
            _clean_text(self._tags.get(0x0110)), focal, stated.original, int(orientation),
            self._read_time(), self._read_place(), self._read_heading(angles),
            find_up(angles) if orientation == 1 else None,
            tuple(self._notes),
        )  # fmt: skip

    def _read_focal(self) -> FocalStatement:
        unit = _MILLIMETRES.get(self._details.get(0xA210, 2), 0.0)
        pitch = _read_number(self._details.get(0xA20E))
        sides = (_read_number(self._details.get(tag)) for tag in (0xA002, 0xA003))
        across, down = (_bound(side, _SIDE) for side in sides)
        return FocalStatement(
            _bound(_read_number(self._details.get(0x920A)), _FOCAL_MM),
            _bound(_read_number(self._details.get(0xA405)), _FOCAL_MM),
            _bound(pitch / unit if pitch and unit else None, _PIXELS_PER_MM),
            _bound(_read_number(self._details.get(0xA404)), (1.0, 100.0)) or 1.0,
            (int(across), int(down)) if across and down else None,
        )

    def _read_time(self) -> float | None:
        text = _clean_text(self._details.get(0x9003))
        try:
            moment = time.strptime(text, "%Y:%m:%d %H:%M:%S")
        except ValueError:
            return None
        if moment.tm_year not in _YEARS:
            return None
        part = _clean_text(self._details.get(0x9291))
        is_part = part.isascii() and part.isdecimal()
        return calendar.timegm(moment) + (float(f"0.{part}") if is_part else 0.0)

    def _read_place(self) -> Place | None:
        if not ({2, 4} <= set(self._gps)):
            return None
        latitude, longitude = (_read_angle(self._gps[tag]) for tag in (2, 4))
        if latitude is None or longitude is None or latitude > 90 or longitude > 180:
            self._notes.append("the position in EXIF is none on the earth and is not used")
            return None
        if latitude == 0 and longitude == 0:  # written before the first fix
            return None
        latitude *= -1 if _clean_text(self._gps.get(1)).upper() == "S" else 1
        longitude *= -1 if _clean_text(self._gps.get(3)).upper() == "W" else 1
        altitude = _read_number(self._gps.get(6)) or 0.0
        if self._gps.get(5) in (1, b"\x01"):
            altitude = -altitude
        bounded = _bound(altitude, _ALTITUDE)
        if bounded is None:
            self._notes.append(f"the altitude in EXIF, {altitude:.4g} m, is impossible")
        error = _bound(_read_number(self._gps.get(31)), _ACCURACY)
        return Place(latitude, longitude, bounded or 0.0, error)

    def _read_heading(self, angles: dict[str, float]) -> float | None:
        if "yaw" in angles:
            return angles["yaw"] % 360.0
        return _bound(_read_number(self._gps.get(17)), (0.0, 360.0))


def _clean_text(value: Any) -> str:
    """Returns the printable beginning of a text, without the zeros that fill it up."""
    if isinstance(value, bytes):
        value = value.decode("utf-8", "replace")
    if not isinstance(value, str):
        return ""
    plain = "".join(c for c in value.split("\0")[0] if c.isprintable())
    return plain.strip()[:_LONGEST_NAME]


def _read_number(value: Any) -> float | None:
    """Returns a number above 0, or None."""
    try:
        number = float(value)
    except (TypeError, ValueError, ArithmeticError):
        return None
    return number if math.isfinite(number) and number > 0 else None


def _bound(value: float | None, limits: tuple[float, float]) -> float | None:
    """Returns a value within limits, or None."""
    return value if value is not None and limits[0] <= value <= limits[1] else None


def _read_angle(parts: Any) -> float | None:
    """Returns degrees, minutes and seconds as degrees, or None."""
    try:
        numbers = [float(part) for part in parts]
    except (TypeError, ValueError, ArithmeticError):
        return None
    angle = sum(number / 60**power for power, number in enumerate(numbers[:3]))
    is_angle = bool(numbers) and min(numbers) >= 0 and math.isfinite(angle)
    return angle if is_angle else None
