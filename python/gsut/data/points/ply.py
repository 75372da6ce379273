"""Point clouds from PLY and LAS files, and to PLY."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from gsut import _core
from gsut.bounds import FARTHEST
from gsut.data.points.las import load_points_las

NO_COLOR = 128  # of points without one
_AXES = ("x", "y", "z")
_COLORS = ("red", "green", "blue")


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
    points, colors, white = _core.read_ply_points(os.fsencode(path))
    if notes is not None and white:
        notes.append(f"{path}: the points' colours are read as numbers of 0 to {white:g}")
    return points, colors


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
