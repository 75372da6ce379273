"""One scene trained in blocks: layout, tasks that are pure functions, workers, merge."""

from gsut.blocks.driver import train_blocks
from gsut.blocks.layout import Layout
from gsut.blocks.plan import choose_count, training_bytes
from gsut.blocks.shares import Shares, find_shares
from gsut.blocks.stages import BlocksResult

__all__ = [
    "BlocksResult",
    "Layout",
    "Shares",
    "choose_count",
    "find_shares",
    "train_blocks",
    "training_bytes",
]
