"""Lists the boxes of MP4 and MOV files, and checks what their tables claim."""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from gsut._core import InputError
from gsut.files import open_binary

# Boxes of boxes, on the way to the tables.
_PARENTS = (b"moov", b"trak", b"mdia", b"minf", b"stbl", b"edts", b"mvex", b"moof", b"traf")
# Tables of FFmpeg's reader: where their number of entries stands, and the bytes of each.
_TABLES = {
    **dict.fromkeys((b"stts", b"ctts", b"co64", b"stsd"), (4, 8)),
    **dict.fromkeys((b"stco", b"stss", b"stps"), (4, 4)),
    **dict.fromkeys((b"stsc", b"elst"), (4, 12)), b"stsz": (8, 4), b"trun": (4, 0),
}  # fmt: skip
_MOST_DEPTH = 8  # of boxes in boxes; tables are five deep


def check_tables(path: Path) -> None:
    """Checks the tables of a film before a decoder takes memory for their entries.

    Raises:
        InputError: one claims more entries than it has bytes for, or all more samples than the
            file has.
    """
    left = os.path.getsize(path)
    with open_binary(path) as file:
        for kind, count, each, room in _list_tables(file, 0, left, 0):
            if not room:  # samples without an entry of their own: of this many bytes in the file
                left -= count * max(each, 1)
            if left < 0 or (room and count * each > room):
                raise InputError(
                    f"{path}: damaged: its table '{kind.decode()}' claims {count:,} entries, more "
                    "than there can be; copy the film from the camera again"
                )


def _list_tables(
    file: BinaryIO, begin: int, end: int, depth: int
) -> Iterator[tuple[bytes, int, int, int]]:
    """Yields kind, number of entries, bytes of each and of all; 0 of all where none is listed."""
    for kind, start, length in list_boxes(file, end, begin):
        last = min(start + length, end)
        if kind in _PARENTS and depth < _MOST_DEPTH:
            yield from _list_tables(file, start, last, depth + 1)
        if kind not in _TABLES:
            continue
        place, each = _TABLES[kind]
        file.seek(start)
        head = file.read(place + 4)
        room = last - start - len(head)
        if len(head) < place + 4 or room < 0:
            continue  # too short for a number of entries
        constant = struct.unpack_from(">I", head, 4)[0] if kind == b"stsz" else 0
        listed = each and not constant
        count = struct.unpack_from(">I", head, place)[0]
        yield kind, count, constant or each, max(room, 1) if listed else 0


def list_boxes(file: BinaryIO, end: int, begin: int = 0) -> Iterator[tuple[bytes, int, int]]:
    """Yields kind, first byte of the content and length of the content of the boxes of a part.

    It ends before a box of an impossible length, and after one that the end cuts off.
    """
    at = begin
    while at + 8 <= end:
        file.seek(at)
        head = file.read(16)
        length, kind = struct.unpack_from(">I4s", head)
        start = 8
        if length == 1 and len(head) == 16:
            length, start = struct.unpack_from(">Q", head, 8)[0], 16
        elif length == 0:
            length = end - at
        if length < start:
            return
        yield kind, at + start, length - start
        at += length


def count_films(path: Path) -> int:
    """Counts the indices of an MP4 or MOV: several where films were pasted into one file."""
    with open_binary(path) as file:
        return sum(kind == b"moov" for kind, _, _ in list_boxes(file, path.stat().st_size))


def is_without_index(path: Path) -> bool:
    """Returns whether an MP4 or MOV has no 'moov' box, which cameras write when recording ends."""
    with open_binary(path) as file:
        kinds = [kind for kind, _, _ in list_boxes(file, path.stat().st_size)]
    return bool(kinds) and kinds[0] in (b"ftyp", b"mdat", b"wide") and b"moov" not in kinds
