"""Makes the blocks' tasks of a round: their Gaussians, views, pixels, context and options."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from gsut.blocks.coarse import Coarse
from gsut.blocks.plan import CONTEXT_MOST, SEGMENTS, block_options, round_of, training_bytes
from gsut.blocks.segment import spread_tiles
from gsut.blocks.shares import Shares, choose_context
from gsut.blocks.task import BlockTask
from gsut.compact import SeenView, seen_views
from gsut.data import Scene
from gsut.gaussians import Gaussians
from gsut.render import Light
from gsut.run import BlockOptions, TrainOptions

# Share of a view's valid pixels from which on a block is trained on it, and most views of a block.
_LEAST_SHARE, _MOST_VIEWS = 0.005, 1500


class TaskMaker:
    """The tasks of one round.

    Args:
        options: of the run, not resolved, with the background that was found.
        blocks: how it is divided.
        coarse: the coarse model; `small`: its scene at the size to look at.
        shares: what the training views show of the blocks.
        coarse_owners: the block of each of the coarse model's Gaussians.
        gaussians, owners: of all blocks as they are now.
        number: of the round, from 0.
    """

    def __init__(
        self,
        options: TrainOptions,
        blocks: BlockOptions,
        coarse: Coarse,
        small: Scene,
        shares: Shares,
        coarse_owners: np.ndarray,
        gaussians: Gaussians,
        owners: np.ndarray,
        number: int,
    ) -> None:
        self._options, self._blocks, self._number = options, blocks, number
        self._scene, self._small, self._light = coarse.scene, small, coarse.light
        self._shares, self._gaussians, self._owners = shares, gaussians, owners
        counts = np.bincount(coarse_owners, minlength=shares.weights.shape[1])
        self._most = np.maximum(1, counts / counts.sum() * options.most_gaussians)

    def own(self, block: int) -> Gaussians:
        """The block's Gaussians."""
        return self._gaussians[self._owners == block]

    def memory(self, block: int) -> int:
        """Bytes that the block's training takes, about."""
        most = self._most_of(block)
        context = min(round(CONTEXT_MOST * most), self._options.most_gaussians - most)
        return training_bytes(
            self._scene, self._options.sh_degree, most, max(0, context), len(self._rows(block))
        )

    def task(self, block: int) -> BlockTask | None:
        """The block's task; None: it has no Gaussian, or no view shows it."""
        rows, own = self._rows(block), self._owners == block
        if not len(rows) or not own.any():
            return None
        indices = [self._scene.train_indices[row] for row in rows]
        tiles = [self._shares.tiles[row, block] for row in rows]
        visits = len(rows) / len(self._scene.train_indices)
        options = block_options(self._options, self._blocks, visits, self._most_of(block))
        begin, end = round_of(options, self._blocks, self._number)
        most = round(CONTEXT_MOST * self._most_of(block))
        context = choose_context(
            self._gaussians, own, self._seen(indices, tiles), most, options.seed
        )
        return BlockTask(
            self._part(indices), options, self._scene.extent, self._light_of(indices), tiles,
            self._gaussians[own], context, begin, end, SEGMENTS,
        )  # fmt: skip

    def _most_of(self, block: int) -> int:
        now = int(np.count_nonzero(self._owners == block))
        return max(now, round(float(self._most[block])))

    def _rows(self, block: int) -> np.ndarray:
        """Rows of `train_indices`: the views that show the block, the heaviest if too many."""
        share = self._shares.weights[:, block] / np.maximum(self._shares.pixels, 1)
        rows = [
            r for r in np.flatnonzero(share >= _LEAST_SHARE) if (r, block) in self._shares.tiles
        ]
        if len(rows) > _MOST_VIEWS:
            rows = sorted(sorted(rows, key=lambda row: (-share[row], row))[:_MOST_VIEWS])
        return np.array(rows, int)

    def _seen(self, indices: list[int], tiles: list[np.ndarray]) -> list[SeenView]:
        """The views, with the pixels that show the block, at the size to look at."""
        views = []
        for index, shown, view in zip(
            indices, tiles, seen_views(self._small, indices), strict=True
        ):
            camera = self._scene.camera(index)
            spread = spread_tiles(shown, view.mask.shape, (camera.height, camera.width))
            views.append(dataclasses.replace(view, mask=view.mask & (spread > 0)))
        return views

    def _part(self, indices: list[int]) -> Scene:
        """The scene of these views alone."""
        nothing = np.zeros((0, 3))
        views = [self._scene.views[index] for index in indices]
        absolute = [
            dataclasses.replace(
                view, image_path=Path(view.image_path).absolute(),
                mask_path=None if view.mask_path is None else Path(view.mask_path).absolute(),
            )
            for view in views
        ]  # fmt: skip
        return self._scene.replace(
            views=absolute, points=nothing, point_colors=nothing,
            train_indices=range(len(views)), test_indices=(),
        )  # fmt: skip

    def _light_of(self, indices: list[int]) -> Light | None:
        light = self._light
        return None if light is None else Light(light.gains[indices], light.falloffs)
