"""A format of lens files: how a file of it is recognised, read and written."""

from __future__ import annotations

import dataclasses
import functools
import importlib
import pkgutil
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from pathlib import Path
from typing import Any

from gsut._core import CalibrationError
from gsut.files import decode_text, parse_json, parse_yaml
from gsut.lens.camera import Camera

_NUMBER = re.compile(r"[-+.\deE]+")
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
        """The keys and values of JSON, YAML or OpenCV's XML; raises CalibrationError for others."""
        if is_opencv_xml(self):
            return _read_opencv_xml(self)
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
        has_ids: whether its cameras have names; of other files `read` gets None.
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
    has_ids: bool = False


def is_opencv_xml(file: LensFile) -> bool:
    """Returns whether a file is what OpenCV's FileStorage writes as XML."""
    return file.path.suffix.lower() == ".xml" and "<opencv_storage" in file.text


def _read_opencv_xml(file: LensFile) -> dict[str, Any]:
    """Reads the numbers, words and matrices of OpenCV's XML as its YAML has them."""
    try:
        root = ElementTree.fromstring(file.text)
    except ElementTree.ParseError as error:
        raise CalibrationError(
            f"{file.source}, line {error.position[0]}: not XML ({error})"
        ) from error
    values: dict[str, Any] = {}
    for element in root:
        parts = {child.tag: (child.text or "").strip() for child in element}
        text = (element.text or "").strip()
        words = text.split()
        is_list = len(words) > 1 and all(map(_NUMBER.fullmatch, words))  # a size: 640 480
        value: Any = words if is_list else text
        values[element.tag] = {**parts, "data": parts["data"].split()} if "data" in parts else value
    return values


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
