"""Point clouds from PLY files."""

from __future__ import annotations

import os

import numpy as np

from gsut import _core

TRIANGULATED = "triangulated.ply"  # of `gsut points`; read where a dataset names no points


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
    points, colors, white = _core.read_ply_points(os.fspath(path))
    if notes is not None and white:
        notes.append(f"{path}: the points' colours are read as numbers of 0 to {white:g}")
    return points, colors
