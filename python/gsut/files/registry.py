"""Lists the readers of file formats, so that each is attacked from the day it is written."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import TypeVar

_Function = TypeVar("_Function", bound=Callable)
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


def register_reader(name: str, *endings: str) -> Callable[[_Function], _Function]:
    """Registers the function below as the reader of a format; the function stays as it is."""

    def register(function: _Function) -> _Function:
        _readers[name] = Reader(name, endings, function.__module__, function.__qualname__)
        return function

    return register


def list_readers() -> list[Reader]:
    """Lists the readers of all modules imported so far, by name."""
    return [_readers[name] for name in sorted(_readers)]
