"""Errors of datasets: each names a place, what was found there and what to do."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from gsut._core import InputError
from gsut.files import FileError

NAMES_SHOWN = 5  # names that a message lists before "and n more"; more do not fit a line


class DatasetError(FileError):
    """A dataset cannot be used as it is.

    Attributes:
        where: file, with line, byte offset or frame where known.
        what: what was found, and what was expected.
        advice: what to do about it.
    """


# Readers pass each error of a single frame to such a function. `raise_error` stops at the first
# one; the doctor's collects them, and the reader continues without that frame.
OnError = Callable[[InputError], None]


def raise_error(error: InputError) -> None:
    """Raises the error, as `load_dataset` does with the first one."""
    raise error


def list_some(names: Sequence[str], between: str = ", ") -> str:
    """Lists the first few names and counts the others."""
    shown, more = between.join(names[:NAMES_SHOWN]), len(names) - NAMES_SHOWN
    return f"{shown} and {more} more" if more > 0 else shown
