"""Writes files so that each appears whole or not at all, whatever happens in between."""

from __future__ import annotations

import contextlib
import errno
import itertools
import json
import math
import os
import platform
import re
import shutil
import stat
import struct
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.orientation import add_orientation
from gsut.system import flush_folder, is_alive, rename_over

_MOST_ALIASES = 16  # of a YAML file
_MOST_LETTERS = 60  # of a name: four bytes each, and a file system takes 255 with an ending
UNFINISHED = ".writing-"  # start of the names of files that are being written


class WriteError(InputError, OSError):
    """A file cannot be written; one sentence says which and why."""


@contextlib.contextmanager
def whole_file(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A path to write to, in the same folder, that becomes `path` once the block ends well.

    It ends as `path` does: some writers choose the format by the name. The file is flushed to the
    disk and renamed; where the block fails, what was there before is unchanged. A link stays: what
    it leads to is written.

    Raises:
        WriteError: the file cannot be written (no such folder, permissions, disk full), or `path`
            is a folder, a device or a pipe.
    """
    check_name(path)
    path = Path(os.path.realpath(path))
    if path.exists() and not path.is_file():
        raise WriteError(f"cannot write {path}: it is not a file; give another name")
    temporary = _name_unfinished(path)
    try:
        yield temporary
        with open(temporary, "r+b") as file:
            os.fsync(file.fileno())
        rename_over(temporary, path)
        flush_folder(path.parent)
    except OSError as error:
        raise WriteError(
            f"cannot write {path}: {error.strerror or error}; is the folder writable and the disk "
            "not full?"
        ) from None
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink()


@contextlib.contextmanager
def whole_folder(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A folder beside `path` to write to, that becomes it once the block ends well.

    Raises:
        InputError: something of this name exists, other than an empty folder, or it cannot be
            created.
    """
    path = Path(path)
    is_folder = path.is_dir() and not path.is_symlink()
    if os.path.lexists(path) and not (is_folder and not os.listdir(path)):
        what = "is not empty" if is_folder else "exists"
        raise InputError(f"{path} {what}; give another folder (nothing was overwritten)")
    with staging_folder(path) as partial:
        yield partial
        rename_over(partial, path)


@contextlib.contextmanager
def staging_folder(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A folder beside `path`, which need not exist, for what is on its way there; it goes at the
    end.

    Raises:
        WriteError: it cannot be created.
    """
    path = Path(path)
    check_name(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        staging = _name_unfinished(path)
        staging.mkdir()
    except OSError as error:
        raise WriteError(
            f"{path} cannot be created ({error.strerror}); name a writable folder"
        ) from None
    try:
        yield staging
    finally:
        shutil.rmtree(staging, ignore_errors=True)


# Names the computer in temporary names: folders may be shared.
_HOST = f"{zlib.crc32(platform.node().encode()):08x}"
_numbers = itertools.count()
_tidied: set[Path] = set()


def _name_unfinished(path: Path) -> Path:
    """Returns an unused name beside `path`; removes what killed processes left there."""
    if path.parent not in _tidied:
        _tidied.add(path.parent)
        remove_unfinished(path.parent)
    return path.with_name(f"{UNFINISHED}{_HOST}-{os.getpid()}-{next(_numbers)}-{path.name}")


def to_file_name(name: str) -> str:
    """Converts a name of any origin, such as a topic of a bag, to one part of a path.

    Letters, digits, dots, dashes and underscores stay; a leading dot does not.
    """
    plain = re.sub(r"[^\w.-]+", "_", name).strip("_")
    return plain.lstrip("._")[:_MOST_LETTERS] or "unnamed"


def claim_name(name: str, taken: set[str]) -> str:
    """Adds a file's name to those taken, with -2, -3 ... before its suffix where it is taken.

    Returns:
        The name as it was added.
    """
    stem, dot, suffix = name.rpartition(".") if "." in name.rpartition("/")[2] else (name, "", "")
    unique, number = name, 2
    while unique in taken:
        unique, number = f"{stem}-{number}{dot}{suffix}", number + 1
    taken.add(unique)
    return unique


def check_name(path: str | os.PathLike[str]) -> None:
    """Raises WriteError for a name with a zero byte, where the system would cut it off: what has
    the shorter name would be overwritten."""
    if b"\0" in os.fsencode(path):
        raise WriteError(
            f"cannot write {os.fspath(path)!r}: the name holds a zero byte; give another name"
        )


def remove_unfinished(folder: Path, *, of_all: bool = False) -> None:
    """Removes what processes were writing to a folder when they were killed.

    Args:
        folder: to look in.
        of_all: nobody else writes there: without asking whose it is.
    """
    for leftover in folder.glob(UNFINISHED + "*"):
        host, _, rest = leftover.name.removeprefix(UNFINISHED).partition("-")
        number = rest.partition("-")[0]
        if not (of_all or (host == _HOST and number.isdecimal() and not is_alive(int(number)))):
            continue
        if leftover.is_dir() and not leftover.is_symlink():
            shutil.rmtree(leftover, ignore_errors=True)
        else:
            with contextlib.suppress(OSError):
                leftover.unlink()


def refuse_existing(path: Path, by: str = "") -> None:
    """Raises InputError where something is there already, or nothing can be: a file is written
    under a new name, and no time is spent on one that nobody can write.

    Args:
        path: to be written.
        by: how another name is given, such as " with -o".
    """
    check_name(path)
    if path.exists():
        raise InputError(f"{path} exists; give another name{by} (nothing was overwritten)")
    folder = path.parent
    if not (folder.is_dir() and os.access(folder, os.W_OK)):
        what = "cannot be written to" if folder.is_dir() else "is no folder that is there"
        raise InputError(f"{path} cannot be written: {folder} {what}; give another name{by}")


def check_regular(path: str | os.PathLike[str]) -> Path:
    """Returns the path of a file to read unless it is a pipe or a device, which may never end.

    Raises:
        OSError: it does, or it leads to a folder or to nothing.
    """
    if b"\0" in os.fsencode(path):  # a name that no file has
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), os.fspath(path))
    mode = os.stat(path).st_mode
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), os.fspath(path))
    if not stat.S_ISREG(mode):
        raise OSError(errno.EINVAL, "a pipe or a device, not a file", os.fspath(path))
    return Path(path)


def write_file(path: str | os.PathLike[str], content: str | bytes) -> None:
    """Writes text (as UTF-8) or bytes, see `whole_file`."""
    with whole_file(path) as temporary:
        if isinstance(content, str):  # names of files in it need not be UTF-8
            content = content.encode(errors="backslashreplace")
        temporary.write_bytes(content)


def write_picture(
    path: str | os.PathLike[str], pixels: Any, quality: int | None = None, turns: int = 0
) -> None:
    """Writes a picture in the format of its name, see `whole_file`.

    Args:
        path: the file.
        pixels: (H, W, 3) uint8 blue, green, red, or (H, W) uint8 or uint16, as OpenCV takes them.
        quality: of JPEG, up to 100.
        turns: quarter turns clockwise that show it upright, see `add_orientation`.
    """
    import cv2  # whose own writer of files does not say why it fails, and leaves what it began

    flags = [] if quality is None else [cv2.IMWRITE_JPEG_QUALITY, quality]
    _, data = cv2.imencode(Path(path).suffix, pixels, flags)
    write_file(path, add_orientation(data.tobytes(), turns))


def read_picture(path: str | os.PathLike[str], flags: int) -> Any:
    """Reads a picture of any name by OpenCV's `flags`; None if it is none."""
    import cv2  # whose own reader of files crashes at a str that is no UTF-8

    return cv2.imread(os.fsencode(path), flags)  # type: ignore[call-overload]


def write_json(path: str | os.PathLike[str], value: Any) -> None:
    """Writes `format_json`, see `whole_file`."""
    write_file(path, format_json(value) + "\n")


# What parsers raise where a file is not what they expect: words for numbers, lists for keys ...
_PARSER_FAILURES = (
    ValueError, TypeError, LookupError, ArithmeticError, AttributeError, RecursionError, EOFError,
    struct.error, zlib.error,
)  # fmt: skip


@contextlib.contextmanager
def reading(fails: Callable[[str], Exception]) -> Iterator[None]:
    """Turns every failure of a parser within into one that names the file.

    Args:
        fails: makes the error of what was wrong, in a few words. Errors of ours pass as they are.
    """
    try:
        yield
    except InputError:
        raise
    except _PARSER_FAILURES as error:
        what = " ".join(str(error).split())[:120]
        raise fails(f"cannot be understood ({type(error).__name__}: {what})") from error


def check_shape(value: Any, shape: Any, name: str = "the content") -> None:
    """Checks that JSON values have a shape.

    Args:
        value: as JSON gives it.
        shape: a type; a frozenset of strings, of which the value is one; {key: shape} of an
            object, whose other keys are free, where a key ending in "?" may be absent and "*"
            stands for every key; [shape] of a list of any length; or a tuple of shapes, of which
            one fits.
        name: of the value, for the error.

    Raises:
        TypeError: says what is not as it should be.
    """
    fits = True
    if isinstance(shape, tuple):
        fits = any(_has_shape(value, each) for each in shape)
    elif isinstance(shape, frozenset):
        fits = isinstance(value, str) and value in shape
    elif isinstance(shape, type):
        fits = isinstance(value, shape) and (shape is bool or not isinstance(value, bool))
    elif not isinstance(value, type(shape)):
        fits = False
    elif isinstance(shape, list):
        for number, entry in enumerate(value):
            check_shape(entry, shape[0], f"{name}[{number}]")
    else:
        for key, inner in shape.items():
            found = value if key == "*" else {key.rstrip("?")} & value.keys()
            if not found and not key.endswith(("?", "*")):
                raise TypeError(f"{name} lacks {key!r}")
            for each in found:
                check_shape(value[each], inner, f"{name}[{each!r}]")
    if not fits:
        raise TypeError(f"{name} is {value!r:.40}")


def _has_shape(value: Any, shape: Any) -> bool:
    try:
        check_shape(value, shape)
    except TypeError:
        return False
    return True


def parse_yaml(text: str, fails: Callable[[str, str], Exception]) -> Any:
    """Reads YAML, also as OpenCV writes it: with a directive of its own and tagged matrices.

    Args:
        text: the file's content.
        fails: makes the error, of the place (", line 3" or "") and the problem.
    """
    import yaml  # here, because gsut --help needs none

    class Loader(yaml.SafeLoader):
        """Stops at an excess of aliases: each can double what it refers to."""

        aliases = 0

        def compose_node(self, parent: Any, index: Any) -> Any:
            self.aliases += self.check_event(yaml.AliasEvent)
            if self.aliases > _MOST_ALIASES:
                mark = self.peek_event().start_mark
                raise yaml.composer.ComposerError(
                    None, None, f"more than {_MOST_ALIASES} aliases", mark
                )
            return super().compose_node(parent, index)

    Loader.add_constructor(
        "tag:yaml.org,2002:opencv-matrix",
        lambda loader, node: loader.construct_mapping(node, deep=True),
    )
    # OpenCV's directive "%YAML:1.0" is not YAML; an empty line keeps the line numbers.
    first, newline, rest = text.partition("\n")
    body = newline + rest if first.startswith("%YAML:") else text
    if body.rstrip().endswith("\n---"):  # `ros2 topic echo` ends each message so
        body = body.rstrip()[:-3]
    try:
        return yaml.load(body, Loader=Loader)  # a SafeLoader
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = f", line {mark.line + 1}" if mark is not None else ""
        raise fails(line, getattr(error, "problem", None) or "cannot be parsed") from error


def format_json(value: Any) -> str:
    """Returns JSON with two spaces of indent; NaN and infinities, which JSON lacks, become null."""
    return json.dumps(to_plain(value), indent=2)


def to_plain(value: Any) -> Any:
    """Turns numpy's types into plain ones, and numbers that JSON lacks into None."""
    if isinstance(value, dict):
        return {str(key): to_plain(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [to_plain(entry) for entry in value]
    if isinstance(value, np.ndarray):
        return to_plain(value.tolist())
    if isinstance(value, np.generic):
        return to_plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, Path):
        return str(value)
    return value
