"""Stores the Gaussians of each block in a file, so that few of them are in memory at once."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from gsut.blocks.layout import Layout
from gsut.blocks.task import Trained
from gsut.blocks.workers import write_state
from gsut.formats import save_ply_parts
from gsut.gaussians import Gaussians, StoredGaussians, merge_gaussians
from gsut.run import read_checkpoint
from gsut.sampling import ENOUGH_SAMPLES


class BlockStore:
    """Stores each block's Gaussians between two turns; every Gaussian belongs to the block it lies
    in.

    Args:
        folder: of the blocks, BLOCK/own0.npz and so on.
        layout: which block a point lies in.
        world_offset: (3,) origin of the Gaussians' coordinates in the layout's.
    """

    def __init__(self, folder: Path, layout: Layout, world_offset: np.ndarray) -> None:
        self._folder, self._layout, self._offset = folder, layout, world_offset
        self._counts: dict[int, list[int]] = {}

    def find_owners(self, gaussians: Gaussians) -> np.ndarray:
        """Returns the blocks (N,) that Gaussians lie in."""
        return self.find_owners_of_points(gaussians.means.astype(np.float64))

    def find_owners_of_points(self, points: np.ndarray) -> np.ndarray:
        """Returns the block (N,) in which each point (N, 3) lies; the Gaussians' coordinates."""
        return self._layout.find_owners(points + self._offset)

    def begin(self, whole: Trained) -> None:
        """Stores the coarse model's Gaussians as turn 0."""
        owners = self.find_owners(whole.gaussians)
        order = np.argsort(owners, kind="stable")
        ends = np.cumsum(np.bincount(owners, minlength=len(self._layout)))
        parts = np.split(order, ends[:-1])
        self.sort(0, [functools.partial(whole.__getitem__, rows) for rows in parts])

    def sort(self, turn: int, parts: Sequence[Callable[[], Trained]]) -> None:
        """Moves each Gaussian to the block that contains it. Does nothing if already done.

        Args:
            turn: number, rising.
            parts: functions that read them; most of a part lie in the block of its number.
        """
        if all(self._name_file(block, turn).is_file() for block in range(len(self._layout))):
            return
        astray: dict[int, list[Trained]] = {}
        for block, read in enumerate(parts):
            part = read()
            owners = self.find_owners(part.gaussians)
            for other in np.setdiff1d(owners, block):
                astray.setdefault(int(other), []).append(part[owners == other])
        for block, read in enumerate(parts):
            part = read()
            stay = part[self.find_owners(part.gaussians) == block]
            own = Trained.join([stay, *astray.pop(block, [])])
            write_state(self._name_file(block, turn), own.as_dict() | {"count": len(own)})

    def read_gaussians(self, block: int, turn: int) -> Gaussians:
        """Reads a block's Gaussians after a turn."""
        return Gaussians(**read_checkpoint(self._name_file(block, turn), ("own",))["own"])

    def read_block(self, block: int, turn: int) -> Trained:
        """Reads a block's Gaussians, with moments if they are trained and not finished."""
        return Trained.from_dict(read_checkpoint(self._name_file(block, turn), ("own", "moments")))

    def count_gaussians(self, turn: int) -> list[int]:
        """Returns the number of Gaussians of each block after a turn."""
        if turn not in self._counts:
            files = (self._name_file(block, turn) for block in range(len(self._layout)))
            self._counts[turn] = [read_checkpoint(file, ("count",))["count"] for file in files]
        return self._counts[turn]

    def save(
        self, path: str | os.PathLike[str], turn: int, comments: Sequence[str], surfels: bool
    ) -> np.ndarray:
        """Writes all Gaussians as a PLY file in the dataset's coordinates, block after block.

        Neighbours of one size stand together.

        Returns:
            The origin (3,) of the file.
        """
        place = self.sample(turn)[0].translate(self._offset)

        def read_in_order() -> Iterator[Gaussians]:
            for block in range(len(self._layout)):
                part = self.read_gaussians(block, turn)
                yield part[StoredGaussians.order_rows(part)].translate(self._offset)

        return save_ply_parts(
            path, read_in_order(), sum(self.count_gaussians(turn)), place, comments, surfels
        )

    def sample(self, turn: int) -> tuple[Gaussians, np.ndarray]:
        """Returns about 20,000 Gaussians, spread evenly, and their blocks."""
        parts, owners, step = [], [], -(-sum(self.count_gaussians(turn)) // ENOUGH_SAMPLES) or 1
        for block in range(len(self._layout)):
            parts.append(self.read_gaussians(block, turn)[::step].copy())
            owners.append(np.full(len(parts[-1]), block))
        return merge_gaussians(parts), np.concatenate(owners)

    def _name_file(self, block: int, turn: int) -> Path:
        folder = self._folder / f"b{block:03d}"
        folder.mkdir(exist_ok=True)
        return folder / f"own{turn}.npz"
