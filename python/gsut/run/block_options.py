"""How a training is divided: number of blocks, memory, workers, cluster."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from gsut._core import InputError
from gsut.run.option_fields import (
    check_options,
    describe_options,
    option,
    parse_size,
    words_of,
)

MOST_BLOCKS = 4096


@describe_options
@dataclasses.dataclass(frozen=True)
class BlockOptions:
    """How a training is divided.

    Raises:
        InputError: a value of the wrong kind or out of range.
    """

    # fmt: off
    blocks: str = option(
        "auto", "Blocks", "train the scene in blocks, in less memory and on many machines: their "
        "number, auto: as few as --memory allows, or a layout.json (see docs/blocks.md)",
    )
    rounds: int = option(
        2, "Blocks", "in the last one, a fifth of the steps, blocks see what their neighbours have "
        "become", low=1, high=2,
    )
    memory: str | None = option(
        None, "Blocks", "that the training may take, such as 8GB; of a cluster each node",
        none="what is free",
    )
    workers: int = option(
        1, "Blocks", "processes side by side, which share --threads; neither they nor a kill of "
        "any changes the result's bits", low=1, high=1024,
    )
    cluster: str | None = option(
        None, "Blocks", "train on a Ray cluster: auto for the one that runs here, or HOST:PORT",
        none="this machine alone",
    )
    # fmt: on

    def __post_init__(self) -> None:
        object.__setattr__(self, "blocks", str(self.blocks))
        check_options(self)
        self.memory_bytes()
        if self.count() is None and self.blocks != "auto" and not Path(self.blocks).is_file():
            raise InputError(
                f"--blocks {self.blocks}: neither auto, nor a number from 1 to {MOST_BLOCKS}, nor "
                "a layout.json that is there"
            )

    def count(self) -> int | None:
        """The number of blocks that was asked for; None: auto, or a file says it."""
        if not self.blocks.isdecimal():
            return None
        number = int(self.blocks)
        if not 1 <= number <= MOST_BLOCKS:
            raise InputError(f"--blocks {number}: from 1 to {MOST_BLOCKS}")
        return number

    def words(self, *but: str) -> list[str]:
        """Words of the command line that divide a training so; nothing of the fields `but`."""
        blocks = [] if "blocks" in but else ["--blocks", self.blocks]
        return blocks + words_of(self, BlockOptions(), ("blocks", *but))

    def memory_bytes(self) -> int | None:
        """--memory as a number; None: not given."""
        return None if self.memory is None else parse_size(self.memory, "--memory")
