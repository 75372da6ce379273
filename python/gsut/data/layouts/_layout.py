"""What a layout of datasets is: how it is recognised, read and written."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

from gsut.data.errors import OnError
from gsut.data.export import Export
from gsut.data.listing import Listing
from gsut.data.recordings import Recording


@dataclasses.dataclass(frozen=True)
class Layout:
    """One way to lay out a dataset's files.

    Args:
        name: for `gsut data convert --to`.
        files: what is looked for, in words: for errors.
        rank: where the files of several are there, the lowest one is read.
        holds: whether this folder (or file) is one.
        read: its frames, points and lists; the argument is what `holds` accepted.
        record: instead of `read`, of a layout whose poses are found by time or order.
        write: into a new folder; None where gsut only reads it.
        unpack: of what holds pictures inside, such as a bag: writes them to a folder; instead of
            `read` and `record`.
    """

    name: str
    files: str
    rank: int
    holds: Callable[[Path], bool]
    read: Callable[[Path, OnError], Listing] | None = None
    record: Callable[[Path], Recording] | None = None
    write: Callable[[Path, Export], list[str]] | None = None
    unpack: Callable[..., Recording] | None = None
