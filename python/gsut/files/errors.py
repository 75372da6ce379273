"""Errors of files: each names the file, what was found there and what to do."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator

from gsut._core import InputError, SolveError

# Makes an error of a place, what was found there, and advice, as `FileError` does.
Fails = Callable[[object, str, str], Exception]
COPY_AGAIN = "the file may be cut off: copy or export it again"


class FileError(InputError):
    """A file cannot be used as it is.

    Attributes:
        where: file, with line, byte offset or entry where known.
        what: what was found, and what was expected.
        advice: what to do about it.
    """

    def __init__(self, where: object, what: str, advice: str) -> None:
        super().__init__(f"{where}: {what}; {advice}")
        self.where, self.what, self.advice = str(where), what, advice


class OpenError(FileError, OSError):
    """A file cannot be opened, or is none: a folder, a pipe, a device."""

    def __str__(self) -> str:
        return str(self.args[0])


class MissingFileError(OpenError, FileNotFoundError):
    """There is no such file."""


class WriteError(InputError, OSError):
    """A file cannot be written; one sentence says which and why."""


@contextlib.contextmanager
def reading(where: object, advice: str = COPY_AGAIN, fails: Fails = FileError) -> Iterator[None]:
    """Turns every failure of a parser within into one that names the file.

    Args:
        where: the file, for the error.
        advice: what to do about a file that cannot be understood.
        fails: makes the error. A `FileError` of the door is made one of these, too; other errors
            of ours pass as they are.
    """
    try:
        yield
    except FileError as error:
        if fails is FileError or (isinstance(fails, type) and isinstance(error, fails)):
            raise
        raise fails(error.where, error.what, error.advice) from error
    except (InputError, SolveError, ImportError):
        raise
    except RecursionError as error:
        raise fails(where, "cannot be understood: nested too deeply", advice) from error
    except MemoryError as error:
        raise fails(where, "reading it needs more memory than there is", advice) from error
    except Exception as error:  # words for numbers, lists for keys, errors of libraries ...
        what = " ".join(str(error).partition("<_io.")[0].split())[:120]  # no object's repr
        raise fails(
            where, f"cannot be understood ({type(error).__name__}: {what})", advice
        ) from error
