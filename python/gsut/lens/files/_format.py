"""A format of lens files: how a file of it is recognised, read and written."""

from __future__ import annotations

import dataclasses
import functools
import importlib
import pkgutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

from gsut._core import CalibrationError
from gsut.files import decode_text, parse_json, parse_yaml
from gsut.lens.camera import Camera

KEYED = (".json", ".yaml", ".yml")  # suffixes of files of keys and values


@dataclasses.dataclass(frozen=True)
class LensFile:
    """A file that may hold a lens.

    Attributes:
        path: the file.
        source: its name as the user gave it, for messages.
        data: its bytes.
    """

    path: Path
    source: str
    data: bytes

    @functools.cached_property
    def text(self) -> str:
        """The content as text; raises CalibrationError if it is not UTF-8."""
        return decode_text(self.data, self.source, fails=make_lens_error)

    @functools.cached_property
    def values(self) -> dict[str, Any]:
        """The keys and values of a JSON or YAML file; raises CalibrationError for any other."""
        parse = parse_json if self.path.suffix.lower() == ".json" else parse_yaml
        return parse(self.text, self.source, dict, fails=make_lens_error)


@dataclasses.dataclass(frozen=True)
class LensFormat:
    """One format, as a module of this folder states it in its `FORMAT` or `FORMATS`.

    Attributes:
        name: to choose it by hand, see `save_camera`.
        program: whose format it is, for messages.
        suffixes: of the files that it may be read from.
        read: reads a camera; the second argument says which one, None the only one.
        has_marks: whether a file with such a suffix is of this format.
        marks: what it is recognised by, in words.
        rank: formats are asked in this order; the lowest one that recognises the file reads it.
        write: formats a lens as the content of a file of this suffix, or raises InputError if the
            program has no such lens; None: gsut only reads it.
        names: patterns of file names that choose it for writing; of several that match, the one
            with the longest ending wins, then the longest one.
        models: names of lenses that it holds, at least with some parameters; blanks part them.
    """

    name: str
    program: str
    suffixes: tuple[str, ...]
    read: Callable[[LensFile, int | str | None], Camera]
    has_marks: Callable[[LensFile], bool] = lambda file: True
    marks: str = ""
    rank: int = 0
    write: Callable[[Camera, str], str | bytes] | None = None
    names: tuple[str, ...] = ()
    models: str = ""


@functools.cache
def list_formats() -> tuple[LensFormat, ...]:
    """Returns every format whose module lies in this folder, in the order of their ranks."""
    package = __name__.rpartition(".")[0]
    folder = [str(Path(__file__).parent)]
    names = [m.name for m in pkgutil.iter_modules(folder) if not m.name.startswith("_")]
    modules = [importlib.import_module(f"{package}.{name}") for name in names]
    found = [each for m in modules for each in getattr(m, "FORMATS", ()) or (m.FORMAT,)]
    return tuple(sorted(found, key=lambda each: (each.rank, each.name)))


def make_lens_error(where: object, what: str, advice: str) -> CalibrationError:
    """Makes the error of a lens file, as `FileError` does."""
    return CalibrationError(f"{where}: {what}; {advice}")
