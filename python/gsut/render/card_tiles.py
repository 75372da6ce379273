"""Cuts a lens' rays into tiles and bounds them by cones, as a graphics card's shaders take them."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

TILE = 16  # pixels a side of a tile
TILE_PIXELS = TILE * TILE
_CELL = 4  # tiles a side of a cell; CELL in forward.wgsl
_RADIUS_MARGIN = 1e-6  # relative: what rounding a radius to float may take from it


class CardTiles:
    """The rays of a camera by tile: all that a shader knows of a lens.

    Args:
        camera: of any lens whose rays meet in one point.

    Attributes:
        tiles, cells: how many (across, down).
        cones: (cells + tiles, 4) float32: unit direction and largest distance of a unit ray from
            it; -1 where no pixel has a ray.
        rays: (tiles, 256, 4) float32: unit ray less its tile's direction; 1 where there is a ray.
    """

    def __init__(self, camera: Any) -> None:
        rays, valid = camera.rays()
        self.width, self.height = camera.width, camera.height
        across, down = -(-camera.width // TILE), -(-camera.height // TILE)
        self.tiles = (across, down)
        self.cells = (-(-across // _CELL), -(-down // _CELL))
        # Padded to whole cells, so that cells and tiles are views of one array.
        whole = np.zeros((self.cells[1] * _CELL * TILE, self.cells[0] * _CELL * TILE, 4))
        whole[: camera.height, : camera.width, :3] = np.where(valid[..., None], rays, 0.0)
        whole[: camera.height, : camera.width, 3] = valid
        by_tile = _cut(whole, TILE)[:down, :across].reshape(across * down, TILE_PIXELS, 4)
        by_cell = _cut(whole, TILE * _CELL).reshape(-1, (TILE * _CELL) ** 2, 4)
        cones = _bound_rays(by_tile)
        self.cones = np.concatenate([_bound_rays(by_cell), cones])
        local = by_tile.copy()
        local[..., :3] -= cones[:, None, :3]
        local[by_tile[..., 3] == 0.0] = 0.0
        self.rays = local.astype(np.float32)

    def join(self, values: np.ndarray) -> np.ndarray:
        """Joins values by tile (tiles, 256, C) to an image (H, W, C)."""
        across, down = self.tiles
        image = values.reshape(down, across, TILE, TILE, -1).swapaxes(1, 2)
        return image.reshape(down * TILE, across * TILE, -1)[: self.height, : self.width]


# Of the last cameras: a film keeps its lens from frame to frame.
find_tiles = functools.lru_cache(maxsize=4)(CardTiles)


def _cut(image: np.ndarray, side: int) -> np.ndarray:
    """Cuts an image (H, W, C) into squares: (down, across, side, side, C)."""
    down, across = image.shape[0] // side, image.shape[1] // side
    return image.reshape(down, side, across, side, -1).swapaxes(1, 2)


def _bound_rays(bundles: np.ndarray) -> np.ndarray:
    """Bounds bundles of rays (B, n, 4) by cones (B, 4)."""
    sums = bundles[..., :3].sum(axis=1)
    norms = np.linalg.norm(sums, axis=1, keepdims=True)
    mean = np.where(norms > 0.0, sums / np.where(norms > 0.0, norms, 1.0), [0.0, 0.0, 1.0])
    mean = mean.astype(np.float32)
    away = np.linalg.norm(bundles[..., :3] - mean[:, None], axis=2)
    radius = np.where(bundles[..., 3] > 0.0, away, 0.0).max(axis=1) * (1.0 + _RADIUS_MARGIN)
    radius[~bundles[..., 3].any(axis=1)] = -1.0
    return np.concatenate([mean, radius[:, None].astype(np.float32)], axis=1)
