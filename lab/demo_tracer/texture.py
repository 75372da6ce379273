"""Looks up textures: linear-light albedo images with bilinear interpolation."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
from numpy.typing import ArrayLike


def to_linear(srgb: np.ndarray) -> np.ndarray:
    """Converts sRGB display values in [0, 1] to linear light (IEC 61966-2-1)."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def to_srgb(linear: np.ndarray) -> np.ndarray:
    """Converts linear light in [0, 1] to sRGB display values (IEC 61966-2-1)."""
    linear = np.maximum(linear, 0.0)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


@dataclasses.dataclass(frozen=True)
class Material:
    """A textured, matt surface.

    Args:
        image: (h, w, 3) float32 linear albedo, its row 0 at the top (largest v).
        size: the image's width and height in the units of the shape's texture coordinates; beyond
            them it is mirrored, so that it repeats without seams.
        emission: the surface shines with this multiple of its image and reflects nothing.
    """

    image: np.ndarray
    size: tuple[float, float] = (1.0, 1.0)
    emission: float = 0.0

    def look_up(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Looks up the albedo (N, 3) at texture coordinates (N,)."""
        height, width = self.image.shape[:2]
        x = _fold(u / np.float32(self.size[0])) * np.float32(width) - np.float32(0.5)
        y = (1 - _fold(v / np.float32(self.size[1]))) * np.float32(height) - np.float32(0.5)
        column, row = np.floor(x), np.floor(y)
        right, below = (x - column)[:, None], (y - row)[:, None]
        left_column = np.clip(column.astype(np.int32), 0, width - 1)
        right_column = np.clip(column.astype(np.int32) + 1, 0, width - 1)
        flat = self.image.reshape(-1, 3)
        lines = []
        for offset in (0, 1):
            line = np.clip(row.astype(np.int32) + offset, 0, height - 1) * width
            left = flat[line + left_column]
            lines.append(left + right * (flat[line + right_column] - left))
        return lines[0] + below * (lines[1] - lines[0])


def _fold(position: np.ndarray) -> np.ndarray:
    """Folds the line onto [0, 1] and back, so that textures repeat without seams."""
    return np.abs(np.mod(position + 1, 2) - 1).astype(np.float32)


def make_noise(
    rng: np.random.Generator, shape: tuple[int, ...], cell: float, octaves: int = 3
) -> np.ndarray:
    """Makes smooth noise (h, w) about 0.5 in [0, 1]; `cell`: pixels of the largest feature."""
    height, width = shape
    total, weight_sum = np.zeros(shape), 0.0
    for octave in range(octaves):
        size = max(cell / 2**octave, 1.0)
        grid = rng.random((int(height / size) + 2, int(width / size) + 2))
        weight = 0.5**octave
        total += weight * cv2.resize(grid, (width, height), interpolation=cv2.INTER_CUBIC)
        weight_sum += weight
    return np.clip(total / weight_sum, 0.0, 1.0)


def blend(below: ArrayLike, above: ArrayLike, amount: np.ndarray | float) -> np.ndarray:
    """Blends two colours: `below` where amount is 0, `above` where it is 1; amount is clamped."""
    share = np.clip(np.asarray(amount, dtype=np.float64), 0.0, 1.0)
    share = share[..., None] if share.ndim == 2 else share
    return np.asarray(below) * (1.0 - share) + np.asarray(above) * share


def finish_picture(srgb: np.ndarray) -> np.ndarray:
    """Converts a painted picture (sRGB) to the linear float32 image of a Material."""
    return np.ascontiguousarray(to_linear(np.clip(srgb, 0.0, 1.0)), dtype=np.float32)
