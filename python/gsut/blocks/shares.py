"""What each view shows of each block, by what the renderer blends: any lens, any occlusion."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from gsut import _core
from gsut.blocks.segment import TILE
from gsut.compact import SeenView, blend_weights, compact, seen_views
from gsut.data import Scene
from gsut.gaussians import SH_C0, Gaussians
from gsut.render import DEFAULT_UNSCENTED

_LEAST = 1 / 255  # share of a pixel that counts: a grey level
_CHANNELS = 3  # blocks that are drawn together, one a colour
_FEW = 6  # blocks up to which all are drawn, of more those alone that a first pass has found
_WORK_VIEWS = 64  # that the work is measured in, and what a block sees of the others


@dataclasses.dataclass(frozen=True)
class Shares:
    """What the views show of the blocks.

    Attributes:
        weights: (V, B) pixels, each with the share that a block has in it, summed.
        pixels: (V,) valid ones.
        tiles: {(view, block): (rows, columns) bool}: tiles that show the block, where any does.
    """

    weights: np.ndarray
    pixels: np.ndarray
    tiles: dict[tuple[int, int], np.ndarray]


def work_of(
    gaussians: Gaussians, scene: Scene, indices: Sequence[int], on_view: Callable[[], object]
) -> np.ndarray:
    """(N,) what each Gaussian costs: its blend weights in some views, spread evenly."""
    chosen = indices[:: -(-len(indices) // _WORK_VIEWS)]
    return blend_weights(gaussians, seen_views(scene, chosen), on_view)


def find_shares(
    gaussians: Gaussians,
    owners: np.ndarray,
    blocks: int,
    small: Scene,
    scene: Scene,
    indices: Sequence[int],
    on_view: Callable[[], object] = lambda: None,
) -> Shares:
    """What views show of blocks.

    Args:
        gaussians: N Gaussians, in the scene's coordinates.
        owners: (N,) their blocks.
        blocks: how many there are.
        small: the scene at the size to look at.
        scene: at the size that is trained at, whose tiles are meant.
        indices: of the views; rows of the result are in their order.
        on_view: called after each.
    """
    weights, pixels = np.zeros((len(indices), blocks)), np.zeros(len(indices))
    tiles: dict[tuple[int, int], np.ndarray] = {}
    renderer, rule = _core.Renderer(), _core.BlendRule()
    for row, (index, view) in enumerate(zip(indices, seen_views(small, indices), strict=True)):
        pixels[row] = np.count_nonzero(view.mask)
        chosen = np.arange(blocks)
        if blocks > _FEW:
            found = np.bincount(owners, blend_weights(gaussians, [view]), minlength=blocks)
            chosen = np.flatnonzero(found > 0)
        image = np.zeros((*view.mask.shape, 3), np.float32)
        for first in range(0, len(chosen), _CHANNELS):
            some = chosen[first : first + _CHANNELS]
            renderer.render(
                _coloured(gaussians, owners, some), view.camera, view.camera_from_world, rule,
                (0.0, 0.0, 0.0), 0, DEFAULT_UNSCENTED, image, None, None, False,
            )  # fmt: skip
            for channel, block in enumerate(some):
                share = np.where(view.mask, image[..., channel], 0.0)
                weights[row, block] = share.sum()
                shown = _tiles_of(share > _LEAST, scene.camera(index))
                if shown.any():
                    tiles[row, int(block)] = shown
        on_view()
    return Shares(weights, pixels, tiles)


def _coloured(gaussians: Gaussians, owners: np.ndarray, blocks: np.ndarray) -> Gaussians:
    """One channel a block: 1 for its Gaussians, 0 for all others."""
    sh = np.full((len(gaussians), 1, 3), -0.5 / SH_C0, np.float32)
    for channel, block in enumerate(blocks):
        sh[owners == block, 0, channel] = 0.5 / SH_C0
    return dataclasses.replace(gaussians, sh=sh)


def _tiles_of(shown: np.ndarray, full: _core.Camera) -> np.ndarray:
    """(rows, columns) bool: tiles of an image of camera `full` with a pixel of `shown` (h, w)."""
    places = [
        ((np.arange(size) + 0.5) * (whole / size) / TILE).astype(int)
        for size, whole in zip(shown.shape, (full.height, full.width), strict=True)
    ]
    out = np.zeros((-(-full.height // TILE), -(-full.width // TILE)), bool)
    rows, columns = np.nonzero(shown)
    out[places[0][rows], places[1][columns]] = True
    return out


def choose_context(
    gaussians: Gaussians, own: np.ndarray, views: Sequence[SeenView], most: int, seed: int
) -> Gaussians:
    """The Gaussians of other blocks that a block is trained among.

    Args:
        gaussians: of all blocks.
        own: (N,) bool, those of the block.
        views: that show the block, with the pixels that do.
        most: rows of the result; where there are more those that the pixels do not show are left
            out, and if they are still too many they are merged.
        seed: of the merging.
    """
    others = gaussians[~own]
    if len(others) <= most:
        return others
    some = views[:: max(1, -(-len(views) // _WORK_VIEWS))]
    weights = blend_weights(gaussians, some)[~own]
    others, weights = others[weights > 0], weights[weights > 0]
    if len(others) <= most:
        return others
    return compact(others, count=most, method="field", scores=weights, seed=seed).gaussians
