"""How a training is divided: number of blocks, memory, workers, cluster."""

from __future__ import annotations

import dataclasses
import math

from gsut._core import InputError
from gsut.bounds import show
from gsut.run.options.fields import (
    check_options,
    define_option,
    describe_options,
    list_words,
)

# Most blocks of a scene: their tasks are kept in one table and one folder.
MOST_BLOCKS = 4096
_UNITS = {"B": 1, "KB": 10**3, "MB": 10**6, "GB": 10**9}


@describe_options
@dataclasses.dataclass(frozen=True)
class BlockOptions:
    """How a training is divided.

    Raises:
        InputError: a value of the wrong kind or out of range.
    """

    # fmt: off
    blocks: str = define_option(
        "auto", "Blocks", "train the scene in blocks, in less memory and on many machines: their "
        "number; auto: as few as --memory allows",
    )
    memory: str | None = define_option(
        None, "Blocks", "memory that the training may use, such as 8GB; on a cluster: per node",
        none="all that is free",
    )
    workers: int = define_option(
        1, "Blocks", "parallel processes, which share --threads; neither their number nor a crash "
        "of one changes the result's bits", low=1, high=1024,
    )
    cluster: str | None = define_option(
        None, "Blocks", "train on a Ray cluster: auto for the one running here, or HOST:PORT",
        none="this machine only",
    )
    # fmt: on

    def __post_init__(self) -> None:
        object.__setattr__(self, "blocks", str(self.blocks))
        check_options(self)
        self.parse_memory()
        self.count()

    def count(self) -> int | None:
        """Returns the number of blocks requested; None: auto."""
        if self.blocks == "auto":
            return None
        number = int(self.blocks) if self.blocks.isdecimal() else 0
        if not 1 <= number <= MOST_BLOCKS:
            raise InputError(
                f"--blocks {show(self.blocks)}: auto, or a number from 1 to {MOST_BLOCKS}"
            )
        return number

    def list_words(self, *but: str) -> list[str]:
        """Lists the words of a command line that divide a training so, without the fields `but`."""
        blocks = [] if "blocks" in but else ["--blocks", self.blocks]
        return blocks + list_words(self, BlockOptions(), ("blocks", *but))

    def parse_memory(self) -> int | None:
        """Returns --memory in bytes, such as 8GB or 123456; None: not given."""
        if self.memory is None:
            return None
        text = self.memory.strip().upper()
        number = text.rstrip("BKMG")
        try:
            size = float(number) * _UNITS[text[len(number) :] or "B"]
        except (ValueError, KeyError):
            raise InputError(f"--memory must be like 8GB or 800MB, found {self.memory!r}") from None
        if not (math.isfinite(size) and size >= 1):
            raise InputError(f"--memory must be a positive size, found {self.memory!r}")
        return int(size)
