"""Reads the boxes of MP4 and MOV files: tracks, their rotation, and the samples of metadata."""

from __future__ import annotations

import dataclasses
import math
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

# Bytes of an index (moov box): days of film have less.
_MOST_INDEX = 256 << 20
# Bytes of one sample of metadata, which lasts about a second.
_MOST_SAMPLE = 16 << 20
# Samples of a track of metadata: a day of a few a frame.
_MOST_SAMPLES = 20_000_000
# Boxes that hold boxes on the way to a track's tables.
_HOLDERS = (b"trak", b"mdia", b"minf", b"stbl")


@dataclasses.dataclass(frozen=True)
class Track:
    """One track of a film.

    Attributes:
        kind: of the media: "vide", "soun", "meta" ...
        format: of the samples: "avc1", "gpmd", "camm" ...
        rotation: degrees clockwise by which frames are turned to be shown, a multiple of 90.
        times, durations: seconds of each sample.
        offsets, sizes: bytes of each sample in the file.
    """

    kind: str
    format: str
    rotation: int
    times: list[float]
    durations: list[float]
    offsets: list[int]
    sizes: list[int]


def read_tracks(path: Path) -> list[Track]:
    """Reads the tracks of an MP4 or MOV; [] of another file, a damaged one or one without index."""
    try:
        with open(path, "rb") as file:
            index = _read_index(file, path.stat().st_size)
        boxes = _split_boxes(index)
        return [track for kind, data in boxes if kind == b"trak" for track in _read_track(data)]
    except (OSError, ArithmeticError, struct.error, ValueError):
        return []


def read_samples(path: Path, track: Track) -> Iterator[tuple[float, float, bytes]]:
    """Yields time and duration in seconds and content of each sample of metadata."""
    try:
        with open(path, "rb") as file:
            size = path.stat().st_size
            rows = zip(track.times, track.durations, track.offsets, track.sizes, strict=False)
            for time, duration, offset, length in rows:
                if length > _MOST_SAMPLE or offset + length > size:
                    return
                file.seek(offset)
                yield time, duration, file.read(length)
    except OSError:
        return


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


def _read_index(file: BinaryIO, end: int) -> bytes:
    """Returns the content of the index, b"" if there is none."""
    for kind, start, length in list_boxes(file, end):
        if kind == b"moov":
            file.seek(start)
            return file.read(length) if length <= _MOST_INDEX else b""
    return b""


def _split_boxes(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Yields kind and content of each box; a damaged box ends the iteration."""
    at = 0
    while at + 8 <= len(data):
        length, kind = struct.unpack_from(">I4s", data, at)
        start = 8
        if length == 1 and at + 16 <= len(data):
            length, start = struct.unpack_from(">Q", data, at + 8)[0], 16
        elif length == 0:
            length = len(data) - at
        if length < start or at + length > len(data):
            return
        yield kind, data[at + start : at + length]
        at += length


def _collect_tables(data: bytes, depth: int = 0) -> dict[bytes, bytes]:
    """Returns the boxes of a track that hold no boxes, by kind."""
    found: dict[bytes, bytes] = {}
    for kind, content in _split_boxes(data):
        if kind in _HOLDERS and depth < len(_HOLDERS):
            found |= _collect_tables(content, depth + 1)
        else:
            found.setdefault(kind, content)
    return found


def _read_track(data: bytes) -> Iterator[Track]:
    """Yields the track of a trak box, nothing if it lacks a table."""
    tables = _collect_tables(data)
    if not {b"tkhd", b"mdhd", b"hdlr", b"stsd", b"stts", b"stsz", b"stsc"} <= set(tables):
        return
    is_long = tables[b"mdhd"][0] == 1
    (scale,) = struct.unpack_from(">I", tables[b"mdhd"], 20 if is_long else 12)
    kind = tables[b"hdlr"][8:12].decode("latin1")
    form = tables[b"stsd"][12:16].decode("latin1")
    rotation = _read_rotation(tables[b"tkhd"])
    if kind in ("vide", "soun"):  # decoded by FFmpeg
        yield Track(kind, form, rotation, [], [], [], [])
        return
    sizes = _read_sizes(tables[b"stsz"])
    times, durations = _read_times(tables[b"stts"], len(sizes), max(1, scale))
    yield Track(kind, form, rotation, times, durations, _find_offsets(tables, sizes), sizes)


def _read_rotation(header: bytes) -> int:
    """Returns the degrees clockwise of a track's matrix, rounded to a multiple of 90."""
    a, b = struct.unpack_from(">ii", header, 52 if header[0] == 1 else 40)
    return round(math.degrees(math.atan2(b, a)) / 90) * 90 % 360


def _read_sizes(table: bytes) -> list[int]:
    size, count = struct.unpack_from(">II", table, 4)
    count = min(count, _MOST_SAMPLES)
    if size:
        return [size] * count
    count = min(count, (len(table) - 12) // 4)
    return list(struct.unpack_from(f">{count}I", table, 12))


def _read_times(table: bytes, count: int, scale: int) -> tuple[list[float], list[float]]:
    times: list[float] = []
    durations: list[float] = []
    now = 0
    for repeat, duration in struct.iter_unpack(">II", table[8 : 8 + (len(table) - 8) // 8 * 8]):
        for _ in range(min(repeat, count - len(times))):
            times.append(now / scale)
            durations.append(duration / scale)
            now += duration
    return times, durations


def _find_offsets(tables: dict[bytes, bytes], sizes: list[int]) -> list[int]:
    """Finds where the samples begin by the offsets of chunks and their numbers of samples."""
    wide = b"co64" in tables
    table = tables.get(b"co64", tables.get(b"stco", b""))[8:]
    form = ">Q" if wide else ">I"
    width = struct.calcsize(form)
    chunks = [each for (each,) in struct.iter_unpack(form, table[: len(table) // width * width])]
    runs = list(
        struct.iter_unpack(">III", tables[b"stsc"][8:][: len(tables[b"stsc"][8:]) // 12 * 12])
    )
    offsets: list[int] = []
    for number, start in enumerate(chunks, 1):
        while len(runs) > 1 and runs[1][0] <= number:
            runs.pop(0)
        for _ in range(runs[0][1] if runs else 0):
            if len(offsets) == len(sizes):
                return offsets
            offsets.append(start)
            start += sizes[len(offsets) - 1]
    return offsets
