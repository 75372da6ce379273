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
    TrainingSize,
    find_round_steps,
    make_block_options,
)
from gsut.blocks.segment import spread_tiles
from gsut.blocks.shares import Shares, choose_context, choose_evenly
from gsut.blocks.store import BlockStore
from gsut.blocks.task import BlockTask, Trained
from gsut.compact import SeenView, list_seen_views
from gsut.data import Scene
from gsut.data.points import has_colors
from gsut.gaussians import Gaussians, merge_gaussians
from gsut.render import Light
from gsut.run import BlockOptions, TrainOptions
from gsut.training.first import seed_first

# Most views that a block is trained on; the memory of more is not used better.
_MOST_VIEWS = 1500


class TaskMaker:
    """Makes the tasks of one turn.

    Args:
        options: of the run, with the background that was found.
        blocks: how it is divided.
        coarse: the coarse model.
        small: its scene at the size to render.
        shares: what the training views show of the blocks.
        store: the Gaussians of all blocks, the coarse model's as turn 0.
        turn: whose Gaussians the tasks continue.
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
        counts = np.array(store.count_gaussians(0))
        self._most = np.maximum(1, counts / counts.sum() * options.most_gaussians)

    def make_own(self, block: int) -> Trained:
        """Returns the block's first Gaussians."""
        own = self._store.read_block(block, self._turn)
        return own if self._number else Trained.join([own, *self._seed_on_points(block, len(own))])

    def _seed_on_points(self, block: int, count: int) -> list[Trained]:
        """Seeds Gaussians on the scene's points in the block if the coarse model has few there."""
        o, scene = self._options, self._scene
        room = round(SEEDED * self._limit_count(block)) - count
        if o.init == "random" or not has_colors(scene):
            return []
        inside = self._store.find_owners_of_points(scene.points) == block
        if room <= 0 or not inside.any():
            return []
        part = scene.replace(points=scene.points[inside], point_colors=scene.point_colors[inside])
        return [Trained(seed_first(part, dataclasses.replace(o, max_gaussians=room)))]

    def estimate_memory(self, block: int) -> int:
        """Estimates the least bytes that the block's training takes."""
        return self._estimate_size(block).estimate_least_bytes()

    def _estimate_size(self, block: int) -> TrainingSize:
        most = self._limit_count(block)
        context = min(round(CONTEXT_MOST * most), self._options.most_gaussians - most)
        degree, views = self._options.sh_degree, len(self._choose_views(block))
        return TrainingSize(self._scene, degree, most, max(0, context), views)

    def make_task(self, block: int) -> BlockTask | None:
        """Makes the block's task; None if it has no Gaussian, or no view shows it."""
        rows, own = self._choose_views(block), self.make_own(block)
        if not len(rows) or not len(own):
            return None
        indices = [self._scene.train_indices[row] for row in rows]
        tiles = [self._shares.tiles[row, block] for row in rows]
        rates = self._shares.rates[rows, block]
        visits = float(rates.sum()) / len(self._scene.train_indices)
        most = self._limit_count(block)
        options = make_block_options(self._options, visits, most)
        begin, end = find_round_steps(options, self._number)
        keep = self._estimate_size(block).limit_photograph_bytes(self._blocks)
        return BlockTask(
            self._select_views(indices), options, most / self._options.most_gaussians,
            self._scene.extent, self._select_light(indices),
            tiles, rates, keep, own, self._choose_context(block, own.gaussians, rows), begin, end,
            SEGMENTS,
        )  # fmt: skip

    def _choose_context(self, block: int, own: Gaussians, rows: np.ndarray) -> Gaussians:
        """Chooses what the block's views show of others: current Gaussians as far as they fit, else
        the coarse model's."""
        most = round(CONTEXT_MOST * self._limit_count(block))
        others = self._shares.find_neighbours(block)
        turns = dict.fromkeys(others.tolist(), 0)
        now, first = self._store.count_gaussians(self._turn), self._store.count_gaussians(0)
        total = sum(first[other] for other in turns)
        for other in turns:
            more = now[other] - first[other]
            if total + more <= most:
                turns[other], total = self._turn, total + more
        parts = [self._store.read_gaussians(other, turns[other]) for other in sorted(turns)]
        some = choose_evenly(rows.tolist())
        views = self._mask_views(
            [self._scene.train_indices[row] for row in some],
            [self._shares.tiles[row, block] for row in some],
        )
        return choose_context(
            own, merge_gaussians([own[:0], *parts]), views, most, self._options.seed
        )

    def _limit_count(self, block: int) -> int:
        return max(self._store.count_gaussians(self._turn)[block], round(float(self._most[block])))

    def _choose_views(self, block: int) -> np.ndarray:
        """Returns rows of `train_indices`: the views that show the block, at most 1500."""
        rates = self._shares.rates[:, block]
        rows = np.flatnonzero(rates)
        if len(rows) > _MOST_VIEWS:
            weights = self._shares.weights[rows, block]
            rows = np.sort(rows[np.argsort(-weights, kind="stable")[:_MOST_VIEWS]])
        return rows

    def _mask_views(self, indices: list[int], tiles: list[np.ndarray]) -> list[SeenView]:
        """Returns the views at the size to render, with the pixels that show the block."""
        views = []
        for index, shown, view in zip(
            indices, tiles, list_seen_views(self._small, indices), strict=True
        ):
            camera = self._scene.camera(index)
            spread = spread_tiles(shown, view.mask.shape, (camera.height, camera.width))
            views.append(dataclasses.replace(view, mask=view.mask & (spread > 0)))
        return views

    def _select_views(self, indices: list[int]) -> Scene:
        """Returns the scene of these views alone, with absolute paths."""
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

    def _select_light(self, indices: list[int]) -> Light | None:
        light = self._light
        return None if light is None else Light(light.gains[indices], light.falloffs)
