"""Lists the readers of file formats, so that each is attacked from the day it is written."""

from __future__ import annotations

import dataclasses
import functools
import os
from collections.abc import Callable
from typing import Any, TypeVar

from gsut.files.errors import COPY_AGAIN, Fails, FileError, reading

_Function = TypeVar("_Function", bound=Callable[..., Any])
_readers: dict[str, Reader] = {}


@dataclasses.dataclass(frozen=True)
class Reader:
    """A function that reads files of one format, or of one family of formats.

    Attributes:
        name: of the format.
        endings: of the names of such files.
        module, function: its place in the code.
    """

    name: str
    endings: tuple[str, ...]
    module: str
    function: str


def register_reader(
    name: str, *endings: str, advice: str = COPY_AGAIN, fails: Fails = FileError
) -> Callable[[_Function], _Function]:
    """Registers a function as the reader of a format, and names the file in its failures.

    A class is registered as it is.

    Args:
        name: of the format.
        endings: of the names of such files.
        advice, fails: see `reading`; the file is the function's first argument that is a path.
    """

    def register(function: _Function) -> _Function:
        _readers[name] = Reader(name, endings, function.__module__, function.__qualname__)
        if isinstance(function, type):
            return function

        @functools.wraps(function)
        def read(*args: Any, **kwargs: Any) -> Any:
            values = (*args, *kwargs.values())
            where = next((v for v in values if isinstance(v, (str, os.PathLike))), name)
            with reading(where, advice, fails):
                return function(*args, **kwargs)

        return read  # type: ignore[return-value]

    return register


def list_readers() -> list[Reader]:
    """Lists the readers of all modules imported so far, by name."""
    return [_readers[name] for name in sorted(_readers)]
