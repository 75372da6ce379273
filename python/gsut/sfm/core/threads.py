"""Sets the number of threads for the duration of a block."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from gsut import _core


@contextlib.contextmanager
def set_threads(count: int) -> Iterator[None]:
    """Sets the number of threads for the duration of the block; 0 uses all cores."""
    before = _core.num_threads()
    if count:
        _core.set_num_threads(count)
    try:
        yield
    finally:
        _core.set_num_threads(before if count else 0)
