"""Writes files so that each appears whole or not at all, whatever happens in between."""

from __future__ import annotations

import contextlib
import itertools
import os
import platform
import shutil
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from gsut._core import InputError
from gsut.files.errors import WriteError
from gsut.files.names import check_name
from gsut.files.opening import check_regular
from gsut.system import flush_folder, is_alive, rename_over

UNFINISHED = ".writing-"  # start of the names of files that are being written


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


def write_file(path: str | os.PathLike[str], content: str | bytes) -> None:
    """Writes text (as UTF-8) or bytes, see `whole_file`."""
    with whole_file(path) as temporary:
        if isinstance(content, str):  # names of files in it need not be UTF-8
            content = content.encode(errors="backslashreplace")
        temporary.write_bytes(content)


@contextlib.contextmanager
def create_file(path: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """Opens a file to be written piece by piece, see `whole_file`."""
    with whole_file(path) as temporary, open(temporary, "wb") as file:
        yield file


def append_text(path: str | os.PathLike[str], text: str) -> None:
    """Adds text to the end of a file, which is made where absent.

    Raises:
        WriteError: it cannot be written.
    """
    try:
        with open(path, "a", encoding="utf-8") as file:
            file.write(text)
    except OSError as error:
        raise WriteError(f"cannot write {path}: {error.strerror or error}") from None


def copy_file(source: str | os.PathLike[str], target: str | os.PathLike[str]) -> None:
    """Copies a file into a folder that is not yet whole, making the folders above it.

    Raises:
        OpenError: it cannot be opened.
        WriteError: its copy cannot be written.
    """
    check_regular(source)
    try:
        Path(target).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source, target)
    except OSError as error:
        raise WriteError(f"cannot write {target}: {error.strerror}; is the disk full?") from None
