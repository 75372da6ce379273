"""Reads surveyed control points, and finds the photographs that show them."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from gsut._core import InputError
from gsut.files import read_table, register_reader
from gsut.sfm.photographs import FEWEST_IMAGES

_COLUMNS = ("name", "use", "x", "y", "z", "sigma", "picture", "u", "v")
_NAMES = {name: name for name in _COLUMNS} | {
    "label": "name", "point": "name", "image": "picture", "photo": "picture", "file": "picture",
    "filename": "picture", "easting": "x", "northing": "y", "elevation": "z", "altitude": "z",
}  # fmt: skip
USES = ("control", "check")
FEWEST_CONTROL = 3  # points off a line: they fix a similarity
ON_A_LINE = 1e-3  # second over first extent of control points that leave a turn open


@dataclasses.dataclass(frozen=True)
class ControlPoint:
    """A surveyed point, and where photographs show it.

    Args:
        name: of the point.
        is_check: it takes no part, so that its residual is an independent error.
        place: (3,) x east, y north, z up in metres.
        sigma: standard deviation of a coordinate in metres.
        pixels: (2,) by name of the picture, in the file's pixels as stored; (0.5, 0.5) is the
            centre of the top-left one.
    """

    name: str
    is_check: bool
    place: np.ndarray
    sigma: float
    pixels: dict[str, np.ndarray]


Sighted = tuple[ControlPoint, dict[int, np.ndarray]]  # with its pixel by number of the photograph


@register_reader("control points", ".csv")
def read_control(path: str | os.PathLike[str]) -> list[ControlPoint]:
    """Reads control points and their pixels from a CSV file with a heading, a line a pixel.

    Args:
        path: columns name,use,x,y,z,sigma,picture,u,v, see `read_table`. `use` is "control" or
            "check". The first line of a point has its use, coordinates and sigma; further lines
            may leave them empty.

    Raises:
        InputError: cannot be read, lacks a column, or a line is wrong; file and line are named.
    """
    heading, table = read_table(path, _NAMES, "name")
    absent = [name for name in _COLUMNS if name not in heading]
    if absent:
        raise InputError(
            f"{path}: the first line must name the columns {','.join(_COLUMNS)}; it lacks "
            f"{','.join(absent)}"
        )
    points: dict[str, ControlPoint] = {}
    for line, row in table:
        where = f"{path}:{line}"
        name, picture = row["name"], row["picture"]
        pixel = _read_numbers(row, ("u", "v"), where)
        if not name or not picture or pixel is None:
            raise InputError(f"{where}: a name, a picture, u and v are needed")
        stated = _read_numbers(row, ("x", "y", "z", "sigma"), where)
        use = row["use"].lower()
        known = points.get(name)
        if known is None:
            if use not in USES or stated is None or not stated[3] > 0:
                raise InputError(
                    f"{where}: the first line of point {name} needs use (control or check), x, y, "
                    "z, and a sigma above 0"
                )
            known = ControlPoint(name, use == "check", stated[:3], float(stated[3]), {})
            points[name] = known
        elif use not in ("", USES[known.is_check]) or not (
            stated is None or np.array_equal(stated, [*known.place, known.sigma])
        ):
            raise InputError(f"{where}: point {name} differs from its first line")
        if picture in known.pixels:
            raise InputError(f"{where}: point {name} has a pixel in {picture} already")
        known.pixels[picture] = pixel
    return list(points.values())


def _read_numbers(row: Mapping[str, str], keys: Sequence[str], where: str) -> np.ndarray | None:
    """Reads numbers of a line; None: all are empty."""
    texts = [row[key] for key in keys]
    if not any(texts):
        return None
    try:
        values = np.array([float(text) for text in texts])
    except ValueError:
        values = np.array([np.nan])
    if not np.isfinite(values).all():
        raise InputError(f"{where}: {', '.join(keys)} must be numbers, found {', '.join(texts)}")
    return values


def find_control(path: str, names: Sequence[str]) -> list[Sighted]:
    """Reads control points and finds the photographs that show them.

    Args:
        names: of the photographs; the file may leave out their folders.

    Returns:
        Each point, with its pixel by number of the photograph.

    Raises:
        InputError: see `read_control`; a picture is unknown or ambiguous, a point is seen in one
            alone, or fewer than three control points are there, or lie on a line.
    """
    by_name: dict[str, list[int]] = {}
    for number, name in enumerate(names):
        for key in {name, Path(name).name}:
            by_name.setdefault(key, []).append(number)
    found = []
    for point in read_control(path):
        seen = {}
        for picture, pixel in point.pixels.items():
            numbers = by_name.get(picture, by_name.get(Path(picture).name, []))
            if len(numbers) != 1:
                raise InputError(
                    f"{path}: point {point.name}: {len(numbers)} photographs are named {picture}; "
                    f"names are like {', '.join(names[:3])}"
                )
            seen[numbers[0]] = pixel
        if len(seen) < FEWEST_IMAGES:
            raise InputError(
                f"{path}: point {point.name} has a pixel in {', '.join(point.pixels)} alone; two "
                "photographs at least must show it"
            )
        found.append((point, seen))
    places = [point.place for point, _ in found if not point.is_check]
    if len(places) < FEWEST_CONTROL:
        raise InputError(
            f"{path}: {len(places)} of {len(found)} points are control points; three at least are "
            "needed, off a line"
        )
    if are_on_line(np.array(places)):
        raise InputError(
            f"{path}: the {len(places)} control points lie on a line, which leaves a turn about it "
            "open; add one beside it"
        )
    return found


def are_on_line(places: np.ndarray) -> bool:
    """Returns whether points (N, 3) leave open a turn about a line."""
    extents = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
    return not extents[1] > ON_A_LINE * extents[0]
