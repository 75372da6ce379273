"""Point clouds from PLY and LAS files, and to PLY."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.bounds import FARTHEST
from gsut.data.points.las import load_points_las

NO_COLOR = 128  # of points without one
_AXES = ("x", "y", "z")
_COLORS = ("red", "green", "blue")
_BYTE = 255.0  # full brightness of 8 bits
_WORD = 65535.0  # full brightness of 16 bits
_OVEREXPOSED = 2.0  # floating-point colours of up to that are of 0 to 1


def load_points(
    path: str | os.PathLike[str], notes: list[str] | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Reads a point cloud from a LAS, LAZ or PLY file; see `load_points_ply`."""
    if Path(path).suffix.lower() not in (".las", ".laz"):
        return load_points_ply(path, notes)
    points, colors = load_points_las(path)
    return points, np.full(points.shape, NO_COLOR, np.uint8) if colors is None else colors


def load_points_ply(
    path: str | os.PathLike[str], notes: list[str] | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Reads a point cloud from a PLY file.

    Args:
        path: properties x y z and, if there, red green blue (or diffuse_red ...): integers of 0 to
            255, or floating-point numbers of 0 to 1; larger ones are taken to be of 0 to 255, or to
            65535.
        notes: gets a sentence where colours were of an unusual range.

    Returns:
        points (N, 3) float64, colors (N, 3) uint8 (mid-grey 128 if the file has none).

    Raises:
        InputError: the file cannot be opened, is no PLY file, misses a property (the message
            names it and what is there), is truncated, or has colours of no known range.
    """
    _, elements, *_ = _core.read_ply_header(os.fsencode(path))
    kinds = {
        name: kind
        for element, _, properties in elements
        for name, kind, _ in properties
        if element == "vertex"
    }
    # Some scanners call their colours diffuse_red ...
    prefix = next((each for each in ("", "diffuse_") if f"{each}red" in kinds), None)
    channels = [] if prefix is None else [prefix + name for name in _COLORS]
    columns = _core.read_ply_columns(os.fsencode(path), [*_AXES, *channels])
    points, levels = np.ascontiguousarray(columns[:, :3]), columns[:, 3:]
    if not channels:
        return points, np.full(points.shape, NO_COLOR, np.uint8)
    whole = all(kinds[name][0] != "f" for name in channels)
    white = _find_white(float(np.fmax.reduce(levels, axis=None, initial=0.0)), whole, path)
    if notes is not None and white != (_BYTE if whole else 1.0):
        notes.append(f"{path}: the points' colours are read as numbers of 0 to {white:g}")
    colors = np.floor(np.clip(np.nan_to_num(levels) * (_BYTE / white), 0.0, _BYTE) + 0.5)
    return points, colors.astype(np.uint8)


def _find_white(largest: float, whole: bool, path: str | os.PathLike[str]) -> float:
    """Returns the value of full brightness among colours of up to `largest`."""
    if not whole and largest <= _OVEREXPOSED:
        return 1.0
    for white in (_BYTE, _WORD):
        if largest <= white + 0.5:
            return white
    raise InputError(
        f"{os.fspath(path)}: colours of up to {largest:g} are neither of 0 to 1, nor to 255, nor "
        "to 65535: scale them to one of these"
    )


def find_usable_points(points: np.ndarray) -> tuple[np.ndarray, str]:
    """Returns which points (N, 3) are usable, (N,) bool, and what is wrong with others, or ""."""
    usable = (np.abs(points) <= FARTHEST).all(axis=1)  # NaN is not
    if usable.all():
        return usable, ""
    return usable, (
        f"{np.count_nonzero(~usable)} of {len(points)} points have NaN, infinite or absurdly large "
        f"coordinates; the first is row {np.argmin(usable)}"
    )


def format_points_ply(points: np.ndarray, colors: np.ndarray) -> bytes:
    """Formats a PLY of points (P, 3), as doubles, with colours (P, 3) uint8."""
    layout = [(name, "<f8") for name in _AXES] + [(name, "u1") for name in _COLORS]
    vertices = np.empty(len(points), dtype=layout)
    for names, columns in ((_AXES, points), (_COLORS, colors)):
        for name, column in zip(names, np.asarray(columns).T, strict=True):
            vertices[name] = column
    types = {"<f8": "double", "u1": "uchar"}
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}"]
    header += [f"property {types[kind]} {name}" for name, kind in layout] + ["end_header", ""]
    return "\n".join(header).encode() + vertices.tobytes()
