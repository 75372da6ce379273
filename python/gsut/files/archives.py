"""Reads and writes zip archives, and unpacks gzip: bounded by what the content claims to be."""

from __future__ import annotations

import contextlib
import os
import zipfile
import zlib
from collections.abc import Iterable, Iterator
from typing import IO

from gsut.files.errors import Fails, FileError
from gsut.files.opening import PathLike, open_binary
from gsut.files.writing import create_file

# Bytes that any archive may unpack to, and times its size for larger ones: arrays with many zeros
# shrink to a fiftieth.
_MOST_UNPACKED = 256 << 20
_MOST_RATIO = 64
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_ENCRYPTED = 1  # bit of a member's flags
_EPOCH = (1980, 1, 1, 0, 0, 0)  # of every member, for the same bytes each time
_PIECE = 1 << 20  # bytes unpacked at a time
_GZIP = 16 + zlib.MAX_WBITS
_DAMAGED = "copy or export it again"


class Archive:
    """A zip archive of checked members.

    Attributes:
        names: of the members, in their order.
    """

    def __init__(self, where: object, archive: zipfile.ZipFile) -> None:
        self._where, self._archive = where, archive
        self.names = tuple(entry.filename for entry in archive.infolist())

    def find_size(self, name: str) -> int:
        """Returns the number of bytes that a member unpacks to, as the archive says."""
        return self._find(name).file_size

    @contextlib.contextmanager
    def open(self, name: str) -> Iterator[IO[bytes]]:
        """Opens a member; reading it to its end checks its checksum."""
        with self._archive.open(self._find(name)) as file:
            yield file

    def read(self, name: str, most_bytes: int = _MOST_UNPACKED) -> bytes:
        """Reads a member.

        Raises:
            FileError: absent, larger than `most_bytes`, or damaged.
        """
        size = self._find(name).file_size
        if size > most_bytes:
            raise FileError(
                f"{self._where}, {name}", f"has {size:,} bytes, and at most {most_bytes:,} are "
                "expected", _DAMAGED,
            )  # fmt: skip
        with self.open(name) as file:
            content = file.read(size + 1)
        if len(content) != size:
            raise FileError(f"{self._where}, {name}", "has another size than stated", _DAMAGED)
        return content

    def _find(self, name: str) -> zipfile.ZipInfo:
        try:
            return self._archive.getinfo(name)
        except KeyError:
            raise FileError(self._where, f"has no {name!r}", _DAMAGED) from None


@contextlib.contextmanager
def open_archive(path: PathLike, *, fails: Fails = FileError) -> Iterator[Archive]:
    """Opens a zip archive; every failure within the block names the file.

    Args:
        path: the file.
        fails: makes the error.

    Raises:
        FileError: not a zip archive, damaged, encrypted, packed by other methods than deflate,
            with two members of one name, a name that leads elsewhere, or too much to unpack.
    """
    with open_binary(path, fails=fails) as file:
        size = os.fstat(file.fileno()).st_size
        try:
            archive = zipfile.ZipFile(file)
        except (zipfile.BadZipFile, OSError, NotImplementedError) as error:
            what = "is empty" if size == 0 else f"is not a whole zip archive ({error})"
            raise FileError(path, what, _DAMAGED) from None
        with archive:
            _check_members(path, archive.infolist(), size)
            yield Archive(path, archive)


def _check_members(path: PathLike, entries: list[zipfile.ZipInfo], size: int) -> None:
    most = max(_MOST_UNPACKED, _MOST_RATIO * size)
    names = [entry.filename for entry in entries]
    for entry in entries:
        problem = ""
        if entry.flag_bits & _ENCRYPTED:
            problem = "is encrypted"
        elif entry.compress_type not in _METHODS:
            problem = f"is packed by method {entry.compress_type}, which is neither 0 nor 8"
        elif not is_plain_name(entry.filename):
            problem = "has a name that leads elsewhere or holds control characters"
        elif len(set(names)) < len(names) and names.count(entry.filename) > 1:
            problem = "is there twice"
        if problem:
            raise FileError(f"{path}, {entry.filename!r:.60}", problem, _DAMAGED)
    total = sum(entry.file_size for entry in entries)
    if total > most:
        raise FileError(
            path, f"would unpack from {size:,} to {total:,} bytes, and at most {most:,} are "
            "expected", "is it such a file?",
        )  # fmt: skip


def is_plain_name(name: str) -> bool:
    """Returns whether the name of an archive's member stays below a folder it is unpacked to."""
    parts = name.replace("\\", "/").split("/")
    return name.isprintable() and parts[0] != "" and ".." not in parts and ":" not in parts[0]


def unpack_gzip(content: bytes, where: object, most_bytes: int) -> bytes:
    """Unpacks gzip data piece by piece.

    Raises:
        FileError: damaged, cut off, or more than `most_bytes`.
    """
    engine, pieces, total = zlib.decompressobj(_GZIP), [], 0
    rest = content
    while not engine.eof:
        try:
            piece = engine.decompress(rest, _PIECE)
        except zlib.error as error:
            raise FileError(where, f"its packed data is damaged ({error})", _DAMAGED) from None
        total, rest = total + len(piece), engine.unconsumed_tail
        if total > most_bytes:
            raise FileError(where, f"would unpack to more than {most_bytes:,} bytes", _DAMAGED)
        if not piece and not rest and not engine.eof:
            raise FileError(where, "ends within its packed data", _DAMAGED)
        pieces.append(piece)
    return b"".join(pieces)


def write_archive(path: PathLike, members: Iterable[tuple[str, bytes]]) -> None:
    """Writes a zip archive, the same bytes for the same members; not deflated."""
    with create_file(path) as file, zipfile.ZipFile(file, "w") as archive:
        for name, content in members:
            archive.writestr(zipfile.ZipInfo(name, _EPOCH), content)
