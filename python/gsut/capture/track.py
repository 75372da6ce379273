"""Reads where a video's camera was: GPS in GoPro's metadata, and in DJI's subtitles."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np

# Bytes of a GPMF record's header: key, type, size, repeats.
_HEADER = 8
# GPMF's types and the characters of Python's struct.
_TYPES = {"b": "b", "B": "B", "s": "h", "S": "H", "l": "i", "L": "I", "f": "f", "d": "d", "j": "q",
          "J": "Q"}  # fmt: skip
# Streams of positions, the best first, and the columns of latitude, longitude and altitude (m):
# of HERO11 and later, of HERO5 to 10, and of drones.
_STREAMS = {"GPS9": (0, 1, 2), "GPS5": (0, 1, 2), "GLPI": (1, 2, 3)}
# Fewest positions of a track.
_FEWEST = 2
# A subtitle with its time.
_CUE = re.compile(r"(\d+):(\d+):(\d+)[,.](\d+) *-->.*?(?=\n\s*\n|\Z)", re.DOTALL)
# Words that precede latitude, longitude and altitude; one is misspelt by DJI.
_NAMES = ("latitude",), ("longitude", "longtitude"), ("abs_alt", "altitude", "rel_alt")
# A number after such a word.
_NUMBER = r"\s*:?\s*(-?\d+\.?\d*)"


def read_track(video: Path) -> np.ndarray:
    """Reads places along a video.

    Args:
        video: a GoPro's MP4, or one of a drone with NAME.SRT beside it.

    Returns:
        (N, 4) seconds since the beginning, latitude and longitude in degrees, altitude in metres;
        (0, 4) if the file has no places.
    """
    for suffix in (".SRT", ".srt"):
        subtitles = video.with_suffix(suffix)
        if subtitles.is_file():
            return _drop_implausible(_parse_subtitles(subtitles.read_text("utf-8", "replace")))
    found: dict[str, list[np.ndarray]] = {}
    for start, length, payload in _read_payloads(video):
        for name, rows in _read_positions(payload):
            times = start + length * np.arange(len(rows)) / len(rows)
            found.setdefault(name, []).append(np.column_stack([times, rows]))
    for name in _STREAMS:
        rows = _drop_implausible(np.concatenate(found.get(name, [np.zeros((0, 4))])))
        if len(rows) >= _FEWEST:
            return rows
    return np.zeros((0, 4))


def interpolate_places(
    track: np.ndarray, times: np.ndarray
) -> list[tuple[float, float, float] | None]:
    """Returns latitude, longitude and altitude at times (N,); None outside the track (M, 4)."""
    if len(track) < _FEWEST:
        return [None] * len(times)
    columns = [np.interp(times, track[:, 0], track[:, axis]) for axis in (1, 2, 3)]
    inside = (times >= track[0, 0]) & (times <= track[-1, 0])
    rows = zip(*columns, strict=True)
    return [
        (float(a), float(b), float(c)) if good else None
        for good, (a, b, c) in zip(inside, rows, strict=True)
    ]


def _drop_implausible(rows: np.ndarray) -> np.ndarray:
    """Sorts rows by time and drops impossible ones and 0, 0, which means that there was no fix."""
    good = np.isfinite(rows).all(axis=1) & (np.abs(rows[:, 1]) <= 90) & (np.abs(rows[:, 2]) <= 180)
    good &= (rows[:, 1] != 0) | (rows[:, 2] != 0)
    rows = rows[good]
    return rows[np.argsort(rows[:, 0], kind="stable")]


def _read_payloads(video: Path) -> Iterator[tuple[float, float, bytes]]:
    """Yields GoPro's metadata: seconds, length in seconds, bytes."""
    import av

    try:
        with av.open(str(video)) as container:
            streams = [
                s
                for s in container.streams.data
                if "GoPro MET" in s.metadata.get("handler_name", "")
            ]
            if not streams:
                return
            for packet in container.demux(streams[0]):
                if packet.size and packet.pts is not None:
                    base = float(packet.time_base)
                    yield packet.pts * base, (packet.duration or 0) * base, bytes(packet)
    except (av.FFmpegError, OSError):
        return  # reading the frames reports what is wrong with the file


def _split_records(data: bytes) -> Iterator[tuple[str, str, int, int, bytes]]:
    """Yields key, type, bytes of a row, number of rows and content of each GPMF record.

    A damaged record ends the iteration.
    """
    at = 0
    while at + _HEADER <= len(data):
        key, kind, size, count = struct.unpack_from(">4scBH", data, at)
        at += _HEADER
        if at + size * count > len(data):
            return
        yield key.decode("latin1"), kind.decode("latin1"), size, count, data[at : at + size * count]
        at += -(-size * count // 4) * 4


def _read_positions(payload: bytes) -> Iterator[tuple[str, np.ndarray]]:
    """Yields the streams of positions in a payload: name, (N, 3)."""
    for _, _, _, _, device in _split_records(payload):
        for name, _, _, _, stream in _split_records(device):
            if name != "STRM":
                continue
            held = {key: rest for key, *rest in _split_records(stream)}
            for wanted, columns in _STREAMS.items():
                rows = _read_rows(held, wanted) if wanted in held else None
                fixed = _read_rows(held, "GPSF") if "GPSF" in held else None
                lost = fixed is not None and fixed[0, 0] < 2  # GPSF: 2 two, 3 three dimensions
                if rows is not None and not lost and rows.shape[1] > max(columns):
                    yield wanted, rows[:, columns]


def _read_rows(held: dict[str, list], key: str) -> np.ndarray | None:
    """Returns the numbers (N, M) of a record, scaled; None if its layout is unknown."""
    kind, size, count, data = held[key]
    if kind == "?":
        kind = held["TYPE"][3].decode("latin1").strip("\0") if "TYPE" in held else ""
    elif kind in _TYPES:
        kind *= size // struct.calcsize(_TYPES[kind])
    layout = ">" + "".join(_TYPES.get(each, "?") for each in kind)
    if not kind or "?" in layout or struct.calcsize(layout) != size or not count:
        return None
    rows = np.array(list(struct.iter_unpack(layout, data)), np.float64)
    if key in ("GPSF", "SCAL") or "SCAL" not in held:
        return rows
    scale = _read_rows(held, "SCAL")
    if scale is None or scale.size not in (1, rows.shape[1]) or not scale.all():
        return None
    return rows / scale.ravel()


def _parse_subtitles(text: str) -> np.ndarray:
    rows = []
    for cue in _CUE.finditer(text):
        hours, minutes, seconds, part = cue.groups()
        time = 3600 * int(hours) + 60 * int(minutes) + int(seconds) + float(f"0.{part}")
        values = [
            next(filter(None, (re.search(rf"\b{n}{_NUMBER}", cue[0], re.I) for n in names)), None)
            for names in _NAMES
        ]
        if all(values):
            rows.append([time, *(float(value[1]) for value in values if value)])
    return np.array(rows, np.float64).reshape(-1, 4)
