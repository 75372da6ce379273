"""Orders points along a Z curve, so that neighbours in space are near in memory."""

from __future__ import annotations

import numpy as np


def order_by_morton_code(points: np.ndarray) -> np.ndarray:
    """Returns (N,) rows in the order of a Z curve with 2^21 steps an axis."""
    low, high = points.min(axis=0).astype(np.float64), points.max(axis=0).astype(np.float64)
    steps = (2**21 - 1) / np.maximum(high - low, 1e-300)
    cells = ((points - low) * steps).astype(np.uint64)
    code = np.zeros(len(points), np.uint64)
    for axis in range(3):
        code |= _spread(cells[:, axis]) << np.uint64(axis)
    return np.argsort(code, kind="stable")


def _spread(values: np.ndarray) -> np.ndarray:
    """Spreads 21 bits so that two zero bits follow each."""
    x = values
    for shift, mask in (
        (32, 0x1F00000000FFFF),
        (16, 0x1F0000FF0000FF),
        (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3),
        (2, 0x1249249249249249),
    ):
        x = (x | (x << np.uint64(shift))) & np.uint64(mask)
    return x
