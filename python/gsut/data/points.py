"""Point clouds from PLY files."""

from __future__ import annotations

import os

import numpy as np

from gsut import _core


def load_points_ply(path: str | os.PathLike[str]) -> tuple[np.ndarray, np.ndarray]:
    """Reads a point cloud from a PLY file.

    Args:
        path: properties x y z and, if there, red green blue (or diffuse_red ...): integers of 0 to
            255, or floating-point numbers of 0 to 1.

    Returns:
        points (N, 3) float64, colors (N, 3) uint8 (mid-grey 128 if the file has none).

    Raises:
        InputError: the file cannot be opened, is no PLY file, misses a property (the message
            names it and what is there) or is truncated.
    """
    points, colors, _ = _core.read_ply_points(os.fspath(path))
    return points, colors
