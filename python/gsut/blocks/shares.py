"""Measures what each view shows of each block, by what the renderer blends, for any lens."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence

import numpy as np

from gsut import _core
from gsut.blocks.segment import TILE
from gsut.compact import SeenView, blend_by_view, blend_weights, compact, list_seen_views
from gsut.data import Scene
from gsut.gaussians import SH_C0, Gaussians, StoredGaussians, merge_gaussians
from gsut.render import place_about

# Blocks that are drawn together, one in each colour channel.
_CHANNELS = 3
# Views in which the work is measured, and what a block sees of the others, spread evenly.
_WORK_VIEWS = 64
# Share of a view's valid pixels from which a block is trained on it.
_LEAST_SHARE = 0.005
# Share of a view from which a block is trained on it in every epoch.
_FULL_SHARE = 0.25


@dataclasses.dataclass(frozen=True)
class Shares:
    """What the views show of the blocks.

    Attributes:
        weights: (V, B) pixels, summed with the share that a block has in each.
        pixels: (V,) numbers of valid pixels.
        tiles: {(view, block): (rows, columns) bool}: tiles that show the block, if its share
            counts.
    """

    weights: np.ndarray
    pixels: np.ndarray
    tiles: dict[tuple[int, int], np.ndarray]

    @functools.cached_property
    def rates(self) -> np.ndarray:
        """The share of the epochs (V, B) in which a block is trained on a view, 0 to 1."""
        shares = self.weights / np.maximum(self.weights.sum(axis=1, keepdims=True), 1e-9)
        rates = np.zeros(shares.shape)
        for row, block in self.tiles:
            rates[row, block] = min(1.0, shares[row, block] / _FULL_SHARE)
        return rates

    def find_neighbours(self, block: int) -> np.ndarray:
        """Returns the other blocks that its views show, the most visible first."""
        seen = self.rates[:, block] @ (self.weights / np.maximum(self.pixels, 1)[:, None])
        seen[block] = 0.0
        return np.argsort(-seen, kind="stable")[: np.count_nonzero(seen)]


def measure_work(
    gaussians: Gaussians, scene: Scene, indices: Sequence[int], on_view: Callable[[], object]
) -> np.ndarray:
    """Returns the cost (N,) of each Gaussian: its blend weights in some views, spread evenly."""
    return blend_weights(gaussians, list_seen_views(scene, choose_evenly(indices)), on_view)


def find_shares(
    gaussians: Gaussians,
    owners: np.ndarray,
    blocks: int,
    small: Scene,
    scene: Scene,
    indices: Sequence[int],
    on_view: Callable[[], object] = lambda: None,
) -> Shares:
    """Measures what views show of blocks.

    Args:
        gaussians: N Gaussians, in the scene's coordinates.
        owners: (N,) their blocks.
        blocks: number of blocks.
        small: the scene at the size to render.
        scene: at the size to train at, which the tiles divide.
        indices: of the views; rows of the result are in their order.
        on_view: called after each.
    """
    weights, pixels = np.zeros((len(indices), blocks)), np.zeros(len(indices))
    tiles: dict[tuple[int, int], np.ndarray] = {}
    marked = dataclasses.replace(gaussians, sh=np.zeros((len(gaussians), 1, 3), np.float32))
    renderer, rule = _core.Renderer(), _core.BlendRule()
    found = blend_by_view(gaussians, (list_seen_views(small, [index])[0] for index in indices))
    for row, (index, each) in enumerate(zip(indices, found, strict=True)):
        view = list_seen_views(small, [index])[0]
        pixels[row] = np.count_nonzero(view.mask)
        weights[row] = np.bincount(owners, each, minlength=blocks)
        chosen = np.flatnonzero(weights[row] >= _LEAST_SHARE * max(pixels[row], 1))
        image = np.zeros((*view.mask.shape, 3), np.float32)
        for first in range(0, len(chosen), _CHANNELS):
            some = chosen[first : first + _CHANNELS]
            _mark(marked.sh, owners, some)
            place = place_about(view.camera_from_world, marked.origin)
            job = _core.RenderJob(view.camera, place, rule=rule, sh_degree=0, keep=False)
            renderer.render(marked, job, image)
            for channel, block in enumerate(some):
                shown = view.mask & (image[..., channel] > StoredGaussians.LEAST_ALPHA)
                if shown.any():
                    tiles[row, int(block)] = _mark_tiles(shown, scene.camera(index))
        on_view()
    return Shares(weights, pixels, tiles)


def _mark(sh: np.ndarray, owners: np.ndarray, blocks: np.ndarray) -> None:
    """Marks each block in its own channel: 1 for its Gaussians, 0 for all others."""
    for channel, block in enumerate(blocks):
        sh[:, 0, channel] = np.where(owners == block, 0.5 / SH_C0, -0.5 / SH_C0)


def _mark_tiles(shown: np.ndarray, full: _core.Camera) -> np.ndarray:
    """Returns (rows, columns) bool: tiles of an image of camera `full` with a pixel of `shown`."""
    places = [
        ((np.arange(size) + 0.5) * (whole / size) / TILE).astype(int)
        for size, whole in zip(shown.shape, (full.height, full.width), strict=True)
    ]
    out = np.zeros((-(-full.height // TILE), -(-full.width // TILE)), bool)
    rows, columns = np.nonzero(shown)
    out[places[0][rows], places[1][columns]] = True
    return out


def choose_evenly(indices: Sequence[int]) -> Sequence[int]:
    """Chooses at most 64 indices, spread evenly."""
    return indices[:: -(-len(indices) // _WORK_VIEWS)]


def choose_context(
    own: Gaussians, others: Gaussians, views: Sequence[SeenView], most: int, seed: int
) -> Gaussians:
    """Chooses the Gaussians of other blocks that a block is trained among.

    Args:
        own: Gaussians of the block.
        others: of other blocks.
        views: that show the block, with the pixels that do.
        most: rows of the result. If there are more, those that the pixels do not show are left out,
            and if they are still too many they are merged.
        seed: of the merging.
    """
    if len(others) <= most:
        return others
    weights = blend_weights(merge_gaussians([own, others]), views)[len(own) :]
    others, weights = others[weights > 0], weights[weights > 0]
    if len(others) <= most:
        return others
    return compact(others, count=most, method="field", scores=weights, seed=seed).gaussians
