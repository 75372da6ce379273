"""Reads what sensors measured during a film: GoPro's GPMF and Google's camera motion (camm)."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from gsut.capture.boxes import Track, read_samples, read_tracks

# Bytes of a GPMF record's header: key, type, size, repeats.
_HEADER = 8
# GPMF's types and the characters of Python's struct.
_TYPES = {"b": "b", "B": "B", "s": "h", "S": "H", "l": "i", "L": "I", "f": "f", "d": "d", "j": "q",
          "J": "Q"}  # fmt: skip
# Streams of GPMF that are read: positions of HERO11 and later, of HERO5 to 10 and of drones, and
# acceleration.
_GPMF_STREAMS = ("GPS9", "GPS5", "GLPI", "ACCL")
# GPMF's axes (Z up, X left, Y backward) as rows of the camera's (x right, y down, z forward).
_CAMERA_AXES = {"X": (-1, 0, 0), "Y": (0, 0, -1), "Z": (0, -1, 0)}
# Order of the axes where a file does not name them.
_AXES = "ZXY"
# Layout of camm's packets with positions by their number, and where latitude begins.
_CAMM_PLACES = {5: ("<3d", 0), 6: ("<dIddf", 2)}
# Least fix of GPS with a position: in two dimensions.
_LEAST_FIX = 2


def read_streams(video: Path) -> dict[str, np.ndarray]:
    """Reads what the sensors of a camera measured during a film.

    Returns:
        By GPMF's names, rows (N, 1 + M) of seconds since the beginning and M values: "ACCL" m/s^2
        in the camera's axes; "GPS5", "GPS9" and "GLPI" as the camera orders them; {} if there are
        none.
    """
    found: dict[str, list[np.ndarray]] = {}
    for track in read_tracks(video):
        read = {"gpmd": _read_gpmf_samples, "camm": _read_camm_samples}.get(track.format)
        for name, rows in read(video, track) if read is not None else ():
            found.setdefault(name, []).append(rows)
    return {
        name: np.concatenate([part for part in parts if part.shape[1] == parts[0].shape[1]])
        for name, parts in found.items()
    }


def _read_camm_samples(video: Path, track: Track) -> Iterator[tuple[str, np.ndarray]]:
    for start, _, data in read_samples(video, track):
        number = struct.unpack_from("<H", data, 2)[0] if len(data) >= 4 else -1
        layout, first = _CAMM_PLACES.get(number, ("", 0))
        if not layout or len(data) < 4 + struct.calcsize(layout):
            continue
        values = struct.unpack_from(layout, data, 4)
        if first and values[1] < _LEAST_FIX:
            continue
        yield "GPS5", np.array([[start, *values[first : first + 3]]])


def _read_gpmf_samples(video: Path, track: Track) -> Iterator[tuple[str, np.ndarray]]:
    for start, length, payload in read_samples(video, track):
        for name, rows in read_gpmf(payload):
            times = start + length * np.arange(len(rows)) / len(rows)
            yield name, np.column_stack([times, rows])


def read_gpmf(payload: bytes) -> Iterator[tuple[str, np.ndarray]]:
    """Yields the streams of one GPMF payload: name, (N, M) values."""
    for _, _, _, _, device in _split_records(payload):
        for name, _, _, _, stream in _split_records(device):
            if name != "STRM":
                continue
            held = {key: rest for key, *rest in _split_records(stream)}
            for wanted in _GPMF_STREAMS:
                rows = _read_rows(held, wanted) if wanted in held else None
                fixed = _read_rows(held, "GPSF") if "GPSF" in held else None
                lost = fixed is not None and fixed[0, 0] < _LEAST_FIX
                if rows is not None and wanted == "ACCL":
                    rows = _turn_axes(rows, held)
                if rows is not None and not lost:
                    yield wanted, rows


def _turn_axes(rows: np.ndarray, held: dict[str, list]) -> np.ndarray | None:
    """Returns (N, 3) in the camera's axes; None if the file names no such axes.

    ORIN names the axis of each number; a small letter is one that points the other way.
    """
    names = held["ORIN"][3].decode("latin1") if "ORIN" in held else _AXES
    if rows.shape[1] != 3 or sorted(names.upper()[:3]) != ["X", "Y", "Z"]:
        return None
    signs = [1 if name.isupper() else -1 for name in names[:3]]
    return rows @ np.array(
        [
            np.multiply(sign, _CAMERA_AXES[name.upper()])
            for sign, name in zip(signs, names, strict=False)
        ]
    )


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
