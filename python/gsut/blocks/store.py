"""The Gaussians of all blocks, each block's in a file: few of them are in memory at once."""

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
from gsut.gaussians import Gaussians, merge_gaussians, order_for_reading
from gsut.run import read_checkpoint

_DOTS = 20_000  # of a sample


class BlockStore:
    """What each block's Gaussians are between two turns; every Gaussian is of the block it lies in.

    Args:
        folder: of the blocks, BLOCK/own0.npz and so on.
        layout: which block a point lies in.
        world_offset: (3,) of the Gaussians' coordinates in the layout's.
    """

    def __init__(self, folder: Path, layout: Layout, world_offset: np.ndarray) -> None:
        self._folder, self._layout, self._offset = folder, layout, world_offset
        self._counts: dict[int, list[int]] = {}

    def owners(self, gaussians: Gaussians) -> np.ndarray:
        """(N,) the blocks that Gaussians lie in."""
        return self.owners_of(gaussians.means.astype(np.float64))

    def owners_of(self, points: np.ndarray) -> np.ndarray:
        """(N,) the blocks that points (N, 3) lie in, in the Gaussians' coordinates."""
        return self._layout.owners(points + self._offset)

    def begin(self, whole: Trained) -> None:
        """Turn 0: the Gaussians of all."""
        owners = self.owners(whole.gaussians)
        order = np.argsort(owners, kind="stable")
        ends = np.cumsum(np.bincount(owners, minlength=len(self._layout)))
        parts = np.split(order, ends[:-1])
        self.sort(0, [functools.partial(whole.__getitem__, rows) for rows in parts])

    def sort(self, turn: int, parts: Sequence[Callable[[], Trained]]) -> None:
        """Puts the Gaussians of a turn to the blocks that they lie in; nothing where that is done.

        Args:
            turn: number, rising.
            parts: read them; most of a part lie in the block of its number.
        """
        if all(self._file(block, turn).is_file() for block in range(len(self._layout))):
            return
        astray: dict[int, list[Trained]] = {}
        for block, read in enumerate(parts):
            part = read()
            owners = self.owners(part.gaussians)
            for other in np.setdiff1d(owners, block):
                astray.setdefault(int(other), []).append(part[owners == other])
        for block, read in enumerate(parts):
            part = read()
            stay = part[self.owners(part.gaussians) == block]
            own = Trained.joined([stay, *astray.pop(block, [])])
            write_state(self._file(block, turn), own.as_dict() | {"count": len(own)})

    def own(self, block: int, turn: int) -> Gaussians:
        """A block's Gaussians after a turn."""
        return Gaussians(**read_checkpoint(self._file(block, turn), ("own",))["own"])

    def trained(self, block: int, turn: int) -> Trained:
        """The same with their moments, if they have been trained and are not finished."""
        return Trained.from_dict(read_checkpoint(self._file(block, turn), ("own", "moments")))

    def counts(self, turn: int) -> list[int]:
        """Their numbers."""
        if turn not in self._counts:
            files = (self._file(block, turn) for block in range(len(self._layout)))
            self._counts[turn] = [read_checkpoint(file, ("count",))["count"] for file in files]
        return self._counts[turn]

    def save(
        self, path: str | os.PathLike[str], turn: int, comments: Sequence[str], surfels: bool
    ) -> np.ndarray:
        """Writes all as a PLY file in the dataset's coordinates, block after block.

        Neighbours of one size stand together. Returns the origin of the file (3,).
        """
        place = self.sample(turn)[0].translate(self._offset)

        def ordered() -> Iterator[Gaussians]:
            for block in range(len(self._layout)):
                part = self.own(block, turn)
                yield part[order_for_reading(part)].translate(self._offset)

        return save_ply_parts(path, ordered(), sum(self.counts(turn)), place, comments, surfels)

    def sample(self, turn: int) -> tuple[Gaussians, np.ndarray]:
        """Some 20,000 Gaussians, spread evenly, and their blocks."""
        parts, owners, step = [], [], -(-sum(self.counts(turn)) // _DOTS) or 1
        for block in range(len(self._layout)):
            parts.append(self.own(block, turn)[::step].copy())
            owners.append(np.full(len(parts[-1]), block))
        return merge_gaussians(parts), np.concatenate(owners)

    def _file(self, block: int, turn: int) -> Path:
        folder = self._folder / f"b{block:03d}"
        folder.mkdir(exist_ok=True)
        return folder / f"own{turn}.npz"
