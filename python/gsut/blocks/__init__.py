"""Trains one scene in blocks: layout, tasks that are pure functions, workers, merge."""

from gsut.blocks.driver import train_blocks
from gsut.blocks.stages import BlocksResult
