"""Makes the blocks' tasks of a round: their Gaussians, views, pixels, context and options."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from gsut.blocks.coarse import Coarse
from gsut.blocks.plan import (
    CONTEXT_MOST,
    SEEDED,
    SEGMENTS,
    block_options,
    least_bytes,
    photograph_bytes,
    round_of,
)
from gsut.blocks.segment import spread_tiles
from gsut.blocks.shares import Shares, choose_context, some_of
from gsut.blocks.store import BlockStore
from gsut.blocks.task import BlockTask, Trained
from gsut.compact import SeenView, seen_views
from gsut.data import Scene
from gsut.data.points import has_colors
from gsut.gaussians import Gaussians, merge_gaussians
from gsut.render import Light
from gsut.run import BlockOptions, TrainOptions
from gsut.training import seed_first

_MOST_VIEWS = 1500  # of a block


class TaskMaker:
    """The tasks of one turn.

    Args:
        options: of the run, not resolved, with the background that was found.
        blocks: how it is divided.
        coarse: the coarse model; `small`: its scene at the size to look at.
        shares: what the training views show of the blocks.
        store: the Gaussians of all blocks, the coarse model's as turn 0.
        turn: whose Gaussians are gone on with.
        number: of the round, from 0.
    """

    def __init__(
        self,
        options: TrainOptions,
        blocks: BlockOptions,
        coarse: Coarse,
        small: Scene,
        shares: Shares,
        store: BlockStore,
        turn: int,
        number: int,
    ) -> None:
        self._options, self._blocks, self._number = options, blocks, number
        self._scene, self._small, self._light = coarse.scene, small, coarse.light
        self._shares, self._store, self._turn = shares, store, turn
        counts = np.array(store.counts(0))
        self._most = np.maximum(1, counts / counts.sum() * options.most_gaussians)

    def own(self, block: int) -> Trained:
        """The block's Gaussians."""
        own = self._store.trained(block, self._turn)
        return own if self._number else Trained.joined([own, *self._seeds(block, len(own))])

    def _seeds(self, block: int, count: int) -> list[Trained]:
        """On the scene's points in the block, where the coarse model has few Gaussians there."""
        o, scene = self._options, self._scene
        room = round(SEEDED * self._most_of(block)) - count
        if o.init == "random" or o.init_count is not None or not has_colors(scene):
            return []
        inside = self._store.owners_of(scene.points) == block
        if room <= 0 or not inside.any():
            return []
        part = scene.replace(points=scene.points[inside], point_colors=scene.point_colors[inside])
        return [Trained(seed_first(part, dataclasses.replace(o.resolve(), init_count=room)))]

    def memory(self, block: int) -> int:
        """Bytes that the block's training takes at least, about."""
        return least_bytes(*self._sizes(block))

    def _sizes(self, block: int) -> tuple[Scene, int, int, int, int]:
        most = self._most_of(block)
        context = min(round(CONTEXT_MOST * most), self._options.most_gaussians - most)
        degree, views = self._options.sh_degree, len(self._rows(block))
        return self._scene, degree, most, max(0, context), views

    def task(self, block: int) -> BlockTask | None:
        """The block's task; None: it has no Gaussian, or no view shows it."""
        rows, own = self._rows(block), self.own(block)
        if not len(rows) or not len(own):
            return None
        indices = [self._scene.train_indices[row] for row in rows]
        tiles = [self._shares.tiles[row, block] for row in rows]
        rates = self._shares.rates[rows, block]
        visits = float(rates.sum()) / len(self._scene.train_indices)
        options = block_options(self._options, self._blocks, visits, self._most_of(block))
        begin, end = round_of(options, self._blocks, self._number)
        keep = photograph_bytes(*self._sizes(block), self._blocks)
        return BlockTask(
            self._part(indices), options, self._scene.extent, self._light_of(indices), tiles,
            rates, keep, own, self._context(block, own.gaussians, rows), begin, end, SEGMENTS,
        )  # fmt: skip

    def _context(self, block: int, own: Gaussians, rows: np.ndarray) -> Gaussians:
        """What the block's views show of others: these as they are now, as far as there is room
        for them, and of the rest the coarse model."""
        most = round(CONTEXT_MOST * self._most_of(block))
        others = self._shares.neighbours(block)
        turns = dict.fromkeys(others.tolist(), 0)
        now, first = self._store.counts(self._turn), self._store.counts(0)
        total = sum(first[other] for other in turns)
        for other in turns:
            more = now[other] - first[other]
            if total + more <= most:
                turns[other], total = self._turn, total + more
        parts = [self._store.own(other, turns[other]) for other in sorted(turns)]
        some = some_of(rows.tolist())
        views = self._seen(
            [self._scene.train_indices[row] for row in some],
            [self._shares.tiles[row, block] for row in some],
        )
        return choose_context(
            own, merge_gaussians([own[:0], *parts]), views, most, self._options.seed
        )

    def _most_of(self, block: int) -> int:
        return max(self._store.counts(self._turn)[block], round(float(self._most[block])))

    def _rows(self, block: int) -> np.ndarray:
        """Rows of `train_indices`: the views that show the block, the heaviest if too many."""
        rates = self._shares.rates[:, block]
        rows = np.flatnonzero(rates)
        if len(rows) > _MOST_VIEWS:
            weights = self._shares.weights[rows, block]
            rows = np.sort(rows[np.argsort(-weights, kind="stable")[:_MOST_VIEWS]])
        return rows

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
