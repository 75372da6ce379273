"""What each view shows of each block, by what the renderer blends: any lens, any occlusion."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence

import numpy as np

from gsut import _core
from gsut.blocks.segment import TILE
from gsut.compact import SeenView, blend_weights, compact, seen_views, weights_by_view
from gsut.data import Scene
from gsut.gaussians import SH_C0, Gaussians, merge_gaussians

_LEAST = 1 / 255  # share of a pixel that counts: a grey level
_CHANNELS = 3  # blocks that are drawn together, one a colour
_WORK_VIEWS = 64  # that the work is measured in, and what a block sees of the others
# Share of a view's valid pixels from which on a block is trained on it, and the share of what the
# view shows with which it is trained on it as often as on any.
_LEAST_SHARE, _FULL_SHARE = 0.005, 0.25


@dataclasses.dataclass(frozen=True)
class Shares:
    """What the views show of the blocks.

    Attributes:
        weights: (V, B) pixels, each with the share that a block has in it, summed.
        pixels: (V,) valid ones.
        tiles: {(view, block): (rows, columns) bool}: tiles that show the block, where it has a
            share in the view that counts.
    """

    weights: np.ndarray
    pixels: np.ndarray
    tiles: dict[tuple[int, int], np.ndarray]

    @functools.cached_property
    def rates(self) -> np.ndarray:
        """(V, B) how often a block is trained on a view, of a plain training's visits: 0 to 1."""
        shares = self.weights / np.maximum(self.weights.sum(axis=1, keepdims=True), 1e-9)
        rates = np.zeros(shares.shape)
        for row, block in self.tiles:
            rates[row, block] = min(1.0, shares[row, block] / _FULL_SHARE)
        return rates

    def neighbours(self, block: int) -> np.ndarray:
        """Numbers of the other blocks that its views show, those that they show most of first."""
        seen = self.rates[:, block] @ (self.weights / np.maximum(self.pixels, 1)[:, None])
        seen[block] = 0.0
        return np.argsort(-seen, kind="stable")[: np.count_nonzero(seen)]


def work_of(
    gaussians: Gaussians, scene: Scene, indices: Sequence[int], on_view: Callable[[], object]
) -> np.ndarray:
    """(N,) what each Gaussian costs: its blend weights in some views, spread evenly."""
    return blend_weights(gaussians, seen_views(scene, some_of(indices)), on_view)


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
    marked = dataclasses.replace(gaussians, sh=np.zeros((len(gaussians), 1, 3), np.float32))
    renderer, rule = _core.Renderer(), _core.BlendRule()
    found = weights_by_view(gaussians, (seen_views(small, [index])[0] for index in indices))
    for row, (index, each) in enumerate(zip(indices, found, strict=True)):
        view = seen_views(small, [index])[0]
        pixels[row] = np.count_nonzero(view.mask)
        weights[row] = np.bincount(owners, each, minlength=blocks)
        chosen = np.flatnonzero(weights[row] >= _LEAST_SHARE * max(pixels[row], 1))
        image = np.zeros((*view.mask.shape, 3), np.float32)
        for first in range(0, len(chosen), _CHANNELS):
            some = chosen[first : first + _CHANNELS]
            _mark(marked.sh, owners, some)
            renderer.render(
                marked,
                _core.RenderJob(
                    view.camera, view.camera_from_world, rule=rule, sh_degree=0, keep=False
                ),
                image,
            )
            for channel, block in enumerate(some):
                shown = view.mask & (image[..., channel] > _LEAST)
                if shown.any():
                    tiles[row, int(block)] = _tiles_of(shown, scene.camera(index))
        on_view()
    return Shares(weights, pixels, tiles)


def _mark(sh: np.ndarray, owners: np.ndarray, blocks: np.ndarray) -> None:
    """One channel a block: 1 for its Gaussians, 0 for all others."""
    for channel, block in enumerate(blocks):
        sh[:, 0, channel] = np.where(owners == block, 0.5 / SH_C0, -0.5 / SH_C0)


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


def some_of(indices: Sequence[int]) -> Sequence[int]:
    """At most 64 of them, spread evenly."""
    return indices[:: -(-len(indices) // _WORK_VIEWS)]


def choose_context(
    own: Gaussians, others: Gaussians, views: Sequence[SeenView], most: int, seed: int
) -> Gaussians:
    """The Gaussians of other blocks that a block is trained among.

    Args:
        own: Gaussians of the block.
        others: of other blocks.
        views: that show the block, with the pixels that do.
        most: rows of the result; where there are more those that the pixels do not show are left
            out, and if they are still too many they are merged.
        seed: of the merging.
    """
    if len(others) <= most:
        return others
    weights = blend_weights(merge_gaussians([own, others]), views)[len(own) :]
    others, weights = others[weights > 0], weights[weights > 0]
    if len(others) <= most:
        return others
    return compact(others, count=most, method="field", scores=weights, seed=seed).gaussians
