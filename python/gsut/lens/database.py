"""Calibrated lenses of real cameras by name: first guesses of a lens and of its readout time.

profiles.json.xz beside this file holds 9,776 calibrations that users of Gyroflow gave away (CC0
1.0; https://github.com/gyroflow/lens_profiles, commit 886fc61), packed by
.ci/pack_lens_profiles.py. They are of other specimens and of uneven quality: starts, not truth.
"""

from __future__ import annotations

import dataclasses
import functools
import lzma
import math
import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.bounds import name_wrong_kinds
from gsut.files import parse_json, read_package_file
from gsut.lens.camera import Camera
from gsut.lens.field import measure_field_of_view
from gsut.lens.files import list_suffixes, load_camera
from gsut.lens.plausible import MOST_STRETCH

_FILE = "profiles.json.xz"
_TEXTS = ("brand", "model", "lens", "setting", "note", "digital_lens")
_WORD = re.compile(r"[^\W_]+")
_PIECE = re.compile(r"[^\W\d_]+|\d+")  # of a word: letters, or digits
# Beyond these a calibration is doubted: a tenth of all is.
_MAX_RMS = 1.5e-3  # of the picture's width
_MAX_OFF_CENTRE = 0.1  # of the picture's size
_MAX_ASPECT = 0.05  # of fx / fy from 1
_FEWEST_IMAGES = 4
_SAME_ASPECT = 0.01
# Shares by which focal lengths differ within which calibrations of one lens count as agreeing.
_AGREE = 0.05


@dataclasses.dataclass(frozen=True)
class LensProfile:
    """One calibration of the database.

    Args:
        brand, model, lens, setting, note: as its author wrote them; a note such as "NO-EIS" says
            whether stabilisation, which crops, was on.
        digital_lens: a warp in the camera that no lens model has, such as "gopro_superview".
        official: whether the database's keepers made it.
        width, height: of the pictures calibrated on, pixels.
        fps: frames a second of the video; None: unknown.
        params: fx fy cx cy k1 k2 k3 k4 of kannala_brandt, in pixels of that size.
        rms: of the calibration's residuals, pixels.
        images: the number of images that it rests on.
        radial_limit: tangent of the largest angle trusted; None: unknown.
        readout_ms: from the first line to the last; negative: bottom to top; None: unknown.
        sizes: other sizes of pictures that share the lens.
    """

    brand: str
    model: str
    lens: str
    setting: str
    note: str
    digital_lens: str
    official: bool
    width: int
    height: int
    fps: float | None
    params: tuple[float, ...]
    rms: float
    images: int
    radial_limit: float | None
    readout_ms: float | None
    sizes: tuple[tuple[int, int], ...]

    @property
    def name(self) -> str:
        """Such as "GoPro HERO9 Black, Max Wide, NO-EIS"."""
        return ", ".join(filter(None, (f"{self.brand} {self.model}", *self._describe_details())))

    def _describe_details(self) -> tuple[str, ...]:
        return self.lens, self.setting, self.note

    def make_camera(self, width: int | None = None, height: int | None = None) -> Camera:
        """Returns the lens for pictures of this size.

        Scaled by the longer side; what the shorter one has more or less was added or cut at both
        edges alike, as cameras make 16:9 of 4:3. Upright pictures get the lens turned, its centre
        in the middle: which way the camera was turned is not known.

        Args:
            width, height: of the pictures, pixels; None: the size calibrated at.

        Raises:
            InputError: a size that is not positive.
        """
        width, height = width or self.width, height or self.height
        fx, fy, cx, cy, *rest = self.params
        long, short = max(self.width, self.height), min(self.width, self.height)
        scale = max(width, height) / long
        off_x, off_y = scale * (cx - self.width / 2), scale * (cy - self.height / 2)
        if (width < height) != (self.width < self.height) and long != short:
            fx, fy, off_x, off_y = fy, fx, 0.0, 0.0
        params = [scale * fx, scale * fy, width / 2 + off_x, height / 2 + off_y, *rest]
        limit = None if self.radial_limit is None else math.atan(self.radial_limit)
        return Camera("kannala_brandt", params, width, height, valid_field_angle=limit)

    @functools.cached_property
    def fov_degrees(self) -> float | None:
        """See `measure_field_of_view`."""
        return measure_field_of_view(self.make_camera())

    @functools.cached_property
    def doubts(self) -> tuple[str, ...]:
        """Returns what speaks against this calibration; empty if nothing does."""
        fx, fy, cx, cy = self.params[:4]
        off = max(abs(cx / self.width - 0.5), abs(cy / self.height - 0.5))
        found = []
        if self.digital_lens:
            found.append(f"warped in the camera ({self.digital_lens})")
        if not self.rms <= _MAX_RMS * self.width:
            found.append(f"residuals of {self.rms:.1f} px")
        if self.images < _FEWEST_IMAGES:
            found.append(f"made from {self.images} images")
        if off > _MAX_OFF_CENTRE:
            found.append(f"centre off by {100 * off:.0f} %")
        if abs(fx / fy - 1) > _MAX_ASPECT:
            found.append("pixels not square")
        if not self._has_rays_in_corners():
            found.append("ends inside the picture")
        return tuple(found)

    def _has_rays_in_corners(self) -> bool:
        corners = [[x, y] for x in (0.0, self.width) for y in (0.0, self.height)]
        return bool(self.make_camera().unproject(np.array(corners))[1].all())

    def rate_size(self, width: int, height: int) -> int:
        """Rates a size of pictures: 0 if known to share the lens, 1 for the same shape, else 2."""
        pair = (max(width, height), min(width, height))
        if pair in {(self.width, self.height), *self.sizes}:
            return 0
        shape = self.width / self.height * pair[1] / pair[0]
        return 1 if abs(shape - 1) < _SAME_ASPECT else 2


@functools.cache
def load_profiles() -> tuple[LensProfile, ...]:
    """Loads all calibrations of the database, except the few that no lens can have."""
    values: dict[str, Any] = parse_json(
        lzma.decompress(read_package_file("gsut.lens", _FILE)), _FILE, dict
    )
    for name in _TEXTS:
        values[name] = [values["texts"][index] for index in values[name]]
    values["official"] = [bool(value) for value in values["official"]]
    values["params"] = [tuple(row) for row in values["params"]]
    values["sizes"] = [tuple(map(tuple, row)) for row in values["sizes"]]
    columns = [values[name] for name in values["columns"]]
    names = values["columns"]
    rows = (dict(zip(names, row, strict=True)) for row in zip(*columns, strict=True))
    stretched = (1 / MOST_STRETCH, MOST_STRETCH)
    return tuple(
        LensProfile(**row)
        for row in rows
        if stretched[0] <= row["params"][0] / row["params"][1] <= stretched[1]
    )


@name_wrong_kinds
def find_lenses(
    words: str | Sequence[str], *, size: tuple[int, int] | None = None
) -> list[LensProfile]:
    """Finds calibrations whose brand, model, lens, setting and note hold all the words.

    Args:
        words: such as "hero9 max wide"; case, spaces and commas do not matter.
        size: width and height of the pictures, to prefer calibrations of such.

    Returns:
        The best first: those whose names say little else; then those that nothing speaks against,
        of the pictures' size, that agree with the other calibrations of the same lens, official,
        with small residuals. Empty if none has all the words.

    Raises:
        InputError: no word is given.
    """
    text = words if isinstance(words, str) else " ".join(words)
    wanted = _split_words(text)
    if not wanted:
        raise InputError("give words of the camera's name, such as: gopro hero9 wide")
    found = [profile for profile in load_profiles() if _has(profile, wanted)]
    usual = _find_usual_focal_lengths(found)

    def rank(profile: LensProfile) -> tuple[Any, ...]:
        off = abs(math.log(_find_relative_focal(profile) / usual[_group(profile)]))
        return (
            _count_words_beyond(profile, wanted), bool(profile.doubts),
            0 if size is None else profile.rate_size(*size), int(off / _AGREE),
            not profile.official, profile.rms / profile.width,
        )  # fmt: skip

    return sorted(found, key=rank)


def find_lens(name: str, size: tuple[int, int] | None = None) -> LensProfile:
    """Returns the best of `find_lenses`.

    Raises:
        InputError: no calibration has all the words; says which word is to blame, if one is.
    """
    found = find_lenses(name, size=size)
    if found:
        return found[0]
    wanted = _split_words(name)
    unknown = [word for word in wanted if not any(_has(p, [word]) for p in load_profiles())]
    which = f": none has {', '.join(map(repr, unknown))}" if unknown else " with all these words"
    raise InputError(
        f"{name!r} is neither a file nor a lens of the database{which}; look with `gsut camera "
        "find WORDS`, or give --fov"
    )


def is_lens_name(text: str | os.PathLike[str]) -> bool:
    """Returns whether this names a lens of the database, and neither is a file nor looks like one.

    A missing "lens.yaml" is a missing file, and so is "folder/lens" unless the database has lenses
    with all these words, as "Nikon Z8, 24-70/F4".
    """
    path = Path(text)
    if path.exists() or path.suffix.lower() in list_suffixes():
        return False
    if not path.parent.name:
        return True
    return not path.parent.exists() and bool(find_lenses(str(text)))


def load_lens(text: str | os.PathLike[str], size: tuple[int, int] | None = None) -> Camera:
    """Loads the lens that `--camera` names, of a file or of the database, scaled to `size`.

    Raises:
        CalibrationError, InputError, OSError: see `load_camera` and `find_lens`.
    """
    if is_lens_name(text):
        return find_lens(str(text), size).make_camera(*(size or (None, None)))
    return load_camera(text)


def _split_words(text: str) -> list[str]:
    return _WORD.findall(text.lower())


@functools.cache
def _split_name(profile: LensProfile) -> tuple[str, str]:
    """Returns the words of the name as they are, and parted where letters and digits meet."""
    said = " ".join((profile.brand, profile.model, *profile._describe_details())).lower()
    return " ".join(_WORD.findall(said)), " ".join(_PIECE.findall(said))


def _has(profile: LensProfile, wanted: Sequence[str]) -> bool:
    """Returns whether each word is inside one of the name's, or made of whole pieces of it.

    "hero5" is "HERO 5", but "nope" is not in "main, Open".
    """
    words, pieces = _split_name(profile)
    return all(word in words or _match_pieces(word).search(pieces) for word in wanted)


@functools.cache
def _match_pieces(word: str) -> re.Pattern[str]:
    return re.compile(r"(?<!\S)" + " ?".join(map(re.escape, word)) + r"(?!\S)")


def _count_words_beyond(profile: LensProfile, wanted: Sequence[str]) -> int:
    """Counts the words of the name, without its note, that are not among the wanted ones."""
    joined = "".join(wanted)
    said = (profile.model, profile.lens, profile.setting)
    return sum(word not in joined for text in said for word in _split_words(text))


def _group(profile: LensProfile) -> tuple[str, ...]:
    """Returns what calibrations of one lens have in common."""
    texts = (profile.brand, profile.model, profile.lens, profile.setting)
    return tuple("".join(_split_words(text)) for text in texts)


def _find_relative_focal(profile: LensProfile) -> float:
    return profile.params[0] / profile.width


def _find_usual_focal_lengths(profiles: Sequence[LensProfile]) -> dict[tuple[str, ...], float]:
    """Returns the median focal length of each lens' calibrations, in widths of the picture."""
    groups: dict[tuple[str, ...], list[LensProfile]] = {}
    for profile in profiles:
        groups.setdefault(_group(profile), []).append(profile)
    trusted = {
        group: [profile for profile in members if not profile.doubts] or members
        for group, members in groups.items()
    }
    return {
        group: float(np.median([_find_relative_focal(profile) for profile in members]))
        for group, members in trusted.items()
    }
