"""Lists the outermost boxes of MP4 and MOV files: a film's type, index and frames."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import BinaryIO


def list_boxes(file: BinaryIO, end: int) -> Iterator[tuple[bytes, int, int]]:
    """Yields kind, first byte of the content and length of the content of the outermost boxes.

    It ends before a box of an impossible length, and after one that the file's end cuts off.
    """
    at = 0
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
