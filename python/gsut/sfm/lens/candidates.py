"""Lists lenses to start from where none is known: fields of view by kinds of lens."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from gsut._core import InputError
from gsut.data.images import read_header
from gsut.lens import Camera
from gsut.sfm.photographs import TANGENT, LensGroup, Photographs

_WIDEST_PERSPECTIVE = 130.0  # degrees across: beyond it tan() stretches the image's edge too much
_UNREADABLE_SIZE = (640, 480)  # pixels, of a camera whose images cannot be read and get no pose
# Fields of view along the longer side (degrees) by kind of lens, r = f tan(b theta) / b: a
# telephoto lens to a wide angle (b = 1), an action camera to a fisheye (stereographic, b = 1/2, and
# equidistant, b = 0).
_LADDER = {
    1.0: (25.0, 35.0, 45.0, 55.0, 65.0, 75.0, 88.0, 102.0),
    0.5: (75.0, 90.0, 110.0, 140.0, 180.0),
    0.0: (75.0, 90.0, 110.0, 135.0, 165.0, 200.0),
}
# Degrees across where nothing is known: between a phone's main and wide camera.
DEFAULT_FIELD = float(np.median(_LADDER[1.0]))


def guess_lenses(photographs: Photographs, fov_degrees: float | None) -> Photographs:
    """Gives the photographs of each unknown lens one to start from.

    Photographs of different sizes are of different lenses.
    """
    cameras, groups = list(photographs.cameras), []
    for group in photographs.unknown_groups:
        sizes = _sort_by_size(photographs, group)
        for (width, height), images in sizes.items():
            own = f"{width} x {height}"
            name = group.name if len(sizes) == 1 else f"{group.name} {own}".strip()
            likely = tuple(c for c in group.candidates if (c.width, c.height) == (width, height))
            guess = next(iter(likely), guess_lens(width, height, fov_degrees or DEFAULT_FIELD))
            for image in images:
                cameras[image] = guess
            groups.append(
                dataclasses.replace(group, name=name, images=np.array(images), candidates=likely)
            )
    return dataclasses.replace(photographs, cameras=cameras, groups=tuple(groups))


def _sort_by_size(photographs: Photographs, group: LensGroup) -> dict[tuple[int, int], list[int]]:
    """Sorts the images of a group by size; unreadable ones, reported already, join the first."""
    sizes: dict[tuple[int, int], list[int]] = {}
    unreadable = []
    for image in group.images.tolist():
        try:
            header = read_header(photographs.paths[image])
        except InputError:
            unreadable.append(image)
        else:
            sizes.setdefault((header.width, header.height), []).append(image)
    first = next(iter(sizes), _UNREADABLE_SIZE)
    sizes[first] = sorted([*sizes.get(first, []), *unreadable])
    return sizes


def guess_lens(width: int, height: int, fov_degrees: float) -> Camera:
    """Returns an undistorted lens of this horizontal field of view, equidistant if it is wide."""
    half = math.radians(fov_degrees / 2)
    if fov_degrees >= _WIDEST_PERSPECTIVE:
        return _make_kannala_brandt(width, height, width / 2 / half, 0.0)
    focal = width / 2 / math.tan(half)
    return Camera("opencv4", [focal, focal, width / 2, height / 2, 0, 0, 0, 0], width, height)


def list_lens_ladder(width: int, height: int, fov_degrees: float | None) -> list[Camera]:
    """Lists Kannala-Brandt lenses with square pixels and a centred principal point.

    Args:
        width, height: of the images.
        fov_degrees: horizontal, if roughly known; None: the whole ladder.
    """
    if fov_degrees is not None:
        return [
            _make_kannala_brandt(
                width, height, width / 2 / _measure_radius(fov_degrees, bend), bend
            )
            for bend in _LADDER
            if bend * fov_degrees < _WIDEST_PERSPECTIVE
        ]
    return [
        make_lens(width, height, field, bend)
        for bend, fields in _LADDER.items()
        for field in fields
    ]


def list_focal_lengths(width: int, fov_degrees: float) -> list[float]:
    """Lists the focal lengths in pixels by which kinds of lenses see a horizontal field."""
    return [
        width / 2 / _measure_radius(fov_degrees, bend)
        for bend, fields in _LADDER.items()
        if bend * fov_degrees < _WIDEST_PERSPECTIVE and (bend == 1 or fov_degrees >= fields[0])
    ]


def make_lens(width: int, height: int, fov_degrees: float, bend: float) -> Camera:
    """Makes a Kannala-Brandt lens near r = f tan(bend theta) / bend.

    Args:
        width, height: of the images.
        fov_degrees: along the longer side.
        bend: 1 perspective, 1/2 stereographic, 0 equidistant.
    """
    focal = max(width, height) / 2 / _measure_radius(fov_degrees, bend)
    return _make_kannala_brandt(width, height, focal, bend)


def _measure_radius(fov_degrees: float, bend: float) -> float:
    """Returns the radius of the edge of the field in focal lengths."""
    half = math.radians(fov_degrees / 2)
    return math.tan(bend * half) / bend if bend else half


def _make_kannala_brandt(width: int, height: int, focal: float, bend: float) -> Camera:
    ks = [factor * bend ** (2 * k) for k, factor in enumerate(TANGENT, 1)]
    return Camera("kannala_brandt", [focal, focal, width / 2, height / 2, *ks], width, height)
