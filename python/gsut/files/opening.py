"""Opens files for reading: regular ones only, of a size that the reader expects."""

from __future__ import annotations

import contextlib
import errno
import importlib.resources
import io
import os
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from gsut.files.errors import Fails, FileError, MissingFileError, OpenError, reading

PathLike = str | os.PathLike[str]
MOST_BYTES = 8 << 30  # of a file that is read as a whole: pictures, scenes, states
MOST_TEXT = 1 << 30  # bytes of a file of text
_CHECK_PATH = "check the path"
SAVE_AS_UTF8 = "save the file as UTF-8"
_LFS = b"version https://git-lfs"
_UTF16 = (b"\xff\xfe", b"\xfe\xff")  # how UTF-16 text starts


def check_regular(path: PathLike) -> Path:
    """Returns the path of a file to read unless it is a pipe or a device, which may never end.

    For libraries that open files themselves; all others use `open_binary`.

    Raises:
        OpenError: it does, or it leads to a folder or to nothing.
    """
    try:
        if b"\0" in os.fsencode(path):  # a name that no file has
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT))
        mode = os.stat(path).st_mode
        if stat.S_ISDIR(mode):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        if not stat.S_ISREG(mode):
            raise OSError(errno.EINVAL, "a pipe or a device, not a file")
        if not os.access(path, os.R_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    except OSError as error:
        raise _make_open_error(path, error) from None
    return Path(path)


def _make_open_error(path: PathLike, error: OSError) -> OpenError:
    kind = MissingFileError if isinstance(error, FileNotFoundError) else OpenError
    made = kind(os.fspath(path), f"cannot be opened ({error.strerror or error})", _CHECK_PATH)
    made.errno, made.strerror = error.errno, error.strerror
    return made


@contextlib.contextmanager
def open_binary(
    path: PathLike, *, most_bytes: int | None = None, fails: Fails = FileError
) -> Iterator[BinaryIO]:
    """Opens a file for reading; every failure within the block names it.

    Raises:
        FileError: it cannot be opened, is a folder, a pipe or a device, has more bytes than
            `most_bytes`, or what is done with it in the block fails.
    """
    with reading(path, fails=fails):
        check_regular(path)
        try:
            file = open(path, "rb")  # noqa: SIM115  # closed below
        except OSError as error:
            raise _make_open_error(path, error) from None
        with file:
            if most_bytes is not None:
                _check_size(path, os.fstat(file.fileno()).st_size, most_bytes)
            if file.peek(len(_LFS))[: len(_LFS)] == _LFS:
                what = "is a pointer of Git LFS in place of the file"
                raise FileError(path, what, "fetch it with `git lfs pull` where it lies")
            yield file


def _check_size(path: PathLike, size: int, most: int) -> None:
    if size > most:
        raise FileError(
            path, f"has {size:,} bytes, and such a file has at most {most:,}", "is it another file?"
        )


@contextlib.contextmanager
def open_text(path: PathLike, *, fails: Fails = FileError) -> Iterator[io.TextIOWrapper]:
    """Opens a file of text to be read line by line, see `open_binary` and `decode_text`."""
    with open_binary(path, fails=fails) as file, reading(path, SAVE_AS_UTF8, fails):
        start = file.read(2)
        file.seek(0)
        yield io.TextIOWrapper(file, encoding=_find_encoding(start))


def _find_encoding(start: bytes) -> str:
    """Finds the encoding of text by its first bytes: Windows' programs also write UTF-16."""
    return "utf-16" if start.startswith(_UTF16) else "utf-8-sig"


def read_bytes(path: PathLike, most_bytes: int = MOST_BYTES, *, fails: Fails = FileError) -> bytes:
    """Reads the bytes of a file, see `open_binary`."""
    with open_binary(path, most_bytes=most_bytes, fails=fails) as file:
        content = file.read()  # not of most_bytes, for which Python would take memory beforehand
        _check_size(path, len(content), most_bytes)
    return content


def read_text(
    path: PathLike,
    most_bytes: int = MOST_TEXT,
    *,
    advice: str = SAVE_AS_UTF8,
    fails: Fails = FileError,
) -> str:
    """Reads text, see `open_binary` and `decode_text`, and raises the same errors."""
    return decode_text(read_bytes(path, most_bytes, fails=fails), path, advice=advice, fails=fails)


def decode_text(
    content: bytes, where: object, *, advice: str = SAVE_AS_UTF8, fails: Fails = FileError
) -> str:
    """Decodes UTF-8 text, or UTF-16 with a byte order mark; line ends become line feeds.

    Args:
        content: the bytes.
        where: the file, for the error.
        advice: what to do about a file of other bytes.
        fails: makes the error.

    Raises:
        FileError: names the first byte that is not text.
    """
    try:
        text = content.decode(_find_encoding(content))
        if (zero := text.find("\0")) >= 0:
            raise fails(where, f"is not text (character {zero} is 0)", advice)
    except UnicodeDecodeError as error:
        what = f"is not text (byte {error.start} is not UTF-8)"
        raise fails(where, what, advice) from error
    return text.replace("\r\n", "\n").replace("\r", "\n")


def read_package_file(package: str, name: str) -> bytes:
    """Reads a file that is part of this program, beside the modules of `package`."""
    return importlib.resources.files(package).joinpath(name).read_bytes()
