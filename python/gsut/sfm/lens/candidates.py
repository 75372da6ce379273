"""Lenses to begin with where none is known: a ladder of fields of view and of kinds of lens."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gsut._core import InputError
from gsut.data.images import read_header
from gsut.lens import Camera
from gsut.sfm.core import TANGENT, Features, Photographs

_FISHEYE_FROM = 110.0  # degrees: wider guesses are fisheyes from the start
_WIDEST_PERSPECTIVE = 130.0  # degrees
_DEFAULT_FIELD = 60.0
# Fields of view along the longer side (degrees) by kind of lens, r = f tan(b theta) / b: a
# telephoto lens to a wide angle (b = 1), an action camera to a fisheye (stereographic, b = 1/2, and
# equidistant, b = 0).
_LADDER = {
    1.0: (25.0, 35.0, 45.0, 55.0, 65.0, 75.0, 88.0, 102.0),
    0.5: (75.0, 90.0, 110.0, 140.0, 180.0),
    0.0: (75.0, 90.0, 110.0, 135.0, 165.0, 200.0),
}
# What no camera's lens goes beyond: focal length over the image's longer side (a fisheye's circle
# of 220 degrees; a field of view of 10 degrees), stretch of the pixels, distance of the principal
# point from the centre over the diagonal, and the share of features that it must have rays for.
_LEAST_FOCAL, _MOST_FOCAL = 0.12, 6.0
_MOST_STRETCH = 0.03
_MOST_OFF_CENTER = 0.08
_LEAST_SEEN = 0.95


def guess_lenses(photographs: Photographs, fov_degrees: float | None) -> Photographs:
    """The photographs with a lens to begin with.

    Raises:
        InputError: images of different sizes (one unknown lens cannot serve both), or a field of
            view that is none.
    """
    sizes: dict[tuple[int, int], Path] = {}
    for path in photographs.paths:
        try:
            header = read_header(path)
        except InputError:
            continue  # unreadable: named already
        sizes.setdefault((header.width, header.height), path)
    if len(sizes) > 1:
        (first, a), (second, b) = list(sizes.items())[:2]
        raise InputError(
            f"the lens is unknown and the images have different sizes: {a.name} is "
            f"{first[0]} x {first[1]}, {b.name} {second[0]} x {second[1]}; give lens files or sort "
            "the images into one folder a camera"
        )
    ((width, height),) = sizes
    guess = guess_lens(width, height, fov_degrees or _DEFAULT_FIELD)
    camera = next(iter(photographs.candidates), guess)
    return dataclasses.replace(photographs, cameras=[camera] * len(photographs))


def guess_lens(width: int, height: int, fov_degrees: float) -> Camera:
    """An undistorted lens of this horizontal field of view: perspective, or equidistant if wide."""
    if not 5 <= fov_degrees <= 300:
        raise InputError(f"--fov takes 5 to 300 degrees, found {fov_degrees:g}")
    half = math.radians(fov_degrees / 2)
    if fov_degrees >= _FISHEYE_FROM:
        return _kannala_brandt(width, height, width / 2 / half, 0.0)
    focal = width / 2 / math.tan(half)
    return Camera("opencv4", [focal, focal, width / 2, height / 2, 0, 0, 0, 0], width, height)


def lens_ladder(width: int, height: int, fov_degrees: float | None) -> list[Camera]:
    """Kannala-Brandt lenses with square pixels and a centred principal point.

    Args:
        width, height: of the images.
        fov_degrees: horizontal, if it is roughly known; None: the whole ladder.
    """
    if fov_degrees is not None:
        guess_lens(width, height, fov_degrees)  # refuses what is no field of view
        return [
            _kannala_brandt(width, height, width / 2 / _radius(fov_degrees, bend), bend)
            for bend in _LADDER
            if bend * fov_degrees < _WIDEST_PERSPECTIVE
        ]
    return [
        lens_of_field(width, height, field, bend)
        for bend, fields in _LADDER.items()
        for field in fields
    ]


def lens_of_field(width: int, height: int, fov_degrees: float, bend: float) -> Camera:
    """A Kannala-Brandt lens near r = f tan(bend theta) / bend.

    Args:
        width, height: of the images.
        fov_degrees: along the longer side.
        bend: 1 perspective, 1/2 stereographic, 0 equidistant.
    """
    focal = max(width, height) / 2 / _radius(fov_degrees, bend)
    return _kannala_brandt(width, height, focal, bend)


def with_added_bend(lens: Camera, change: float) -> Camera:
    """A Kannala-Brandt lens with more or less k1, its edge of the image at the same angle."""
    params = lens.params.copy()
    rays, valid = lens.unproject(np.array([[0.0, lens.height / 2], [lens.width / 2, 0.0]]))
    theta = float(np.max(np.arctan2(np.hypot(rays[valid, 0], rays[valid, 1]), rays[valid, 2])))
    powers = theta ** np.array([2, 4, 6, 8])
    before = 1 + float(params[4:] @ powers)
    params[4] += change
    params[:2] *= before / (1 + float(params[4:] @ powers))
    return lens.with_params(params)


def _radius(fov_degrees: float, bend: float) -> float:
    """Of the edge of the field, in focal lengths."""
    half = math.radians(fov_degrees / 2)
    return math.tan(bend * half) / bend if bend else half


def _kannala_brandt(width: int, height: int, focal: float, bend: float) -> Camera:
    ks = [factor * bend ** (2 * k) for k, factor in enumerate(TANGENT, 1)]
    return Camera("kannala_brandt", [focal, focal, width / 2, height / 2, *ks], width, height)


def implausible(lens: Camera, features: Sequence[Features]) -> str | None:
    """Why no camera has this lens; None if one may.

    Args:
        lens: with fx, fy, cx, cy first.
        features: of images, where the lens must have rays.
    """
    fx, fy, cx, cy = lens.params[:4]
    longer = max(lens.width, lens.height)
    if not _LEAST_FOCAL <= fx / longer <= _MOST_FOCAL:
        return f"its focal length is {fx / longer:.2f} times the longer side"
    if abs(fx / fy - 1) > _MOST_STRETCH:
        return f"its pixels are stretched by {100 * abs(fx / fy - 1):.0f} %"
    off = math.hypot(cx - lens.width / 2, cy - lens.height / 2)
    if off > _MOST_OFF_CENTER * math.hypot(lens.width, lens.height):
        return f"its principal point is {off:.0f} px from the image's centre"
    pixels = np.concatenate([f.pixels[:: max(1, len(f) // 200)] for f in features[:50]])
    seen = float(lens.unproject(pixels)[1].mean()) if len(pixels) else 1.0
    if seen < _LEAST_SEEN:
        return f"it has no ray at {100 * (1 - seen):.0f} % of the features"
    return None
