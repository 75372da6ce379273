"""Reads what sensors measured during a film: GoPro's GPMF and Google's camera motion (camm)."""

from __future__ import annotations

import contextlib
import os
import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from gsut.capture.streams import find_quarter_turns, list_films
from gsut.capture.video import open_container

# Bytes of a GPMF record's header: key, type, size, repeats.
_HEADER = 8
# Start of a GPMF payload, which holds devices.
_GPMF_START = b"DEVC"
# Bytes of one sample of metadata, which lasts about a second.
_MOST_SAMPLE = 16 << 20
# GPMF's types and numpy's.
_TYPES = {"b": "i1", "B": "u1", "s": "i2", "S": "u2", "l": "i4", "L": "u4", "f": "f4", "d": "f8",
          "j": "i8", "J": "u8"}  # fmt: skip
# Streams of GPMF that are read: positions of HERO11 and later, of HERO5 to 10 and of drones,
# acceleration, angular velocity, and a frame's orientations of camera and stabilised picture.
_GPMF_STREAMS = ("GPS9", "GPS5", "GLPI", "ACCL", "GYRO", "CORI", "IORI")
# Of these the ones of a sensor, in its axes.
_SENSORS = ("ACCL", "GYRO")
# Microseconds at which a payload of the gyroscope begins by the camera's clock, as a stream.
STAMPS = "GYRO STMP"
# Acceleration in the axes of the gyroscope, which camm does not name, as a stream.
SENSOR_ACCL = "ACCL of camm"
# How far a matrix times its transpose may be from the identity to be one of axes.
_SQUARE = 0.05
# GPMF's axes (Z up, X left, Y backward) as rows of the camera's (x right, y down, z forward).
_CAMERA_AXES = {"X": (-1, 0, 0), "Y": (0, 0, -1), "Z": (0, -1, 0)}
# Order of the axes where a file does not name them.
_AXES = "ZXY"
# Layout of camm's packets with positions by their number, and where latitude begins.
_CAMM_PLACES = {5: ("<3d", 0), 6: ("<dIddf", 2)}
# Streams of camm's packets of a sensor, in its axes, by their number.
_CAMM_SENSORS = {2: "GYRO", 3: SENSOR_ACCL}
# Their layout.
_CAMM_SENSOR = "<3f"
# Least fix of GPS with a position: in two dimensions.
_LEAST_FIX = 2


def read_streams(video: Path) -> tuple[int, dict[str, np.ndarray]]:
    """Reads how a film's frames are turned, and what the sensors of the camera measured.

    Returns:
        Degrees clockwise by which frames are turned to be shown, a multiple of 90. By GPMF's names,
        rows (N, 1 + M) of seconds since the beginning and M values: "ACCL" m/s^2 in the camera's
        axes, SENSOR_ACCL in the gyroscope's; "GYRO" rad/s; "CORI" and "IORI" quaternions (w, x, y,
        z) of a frame each; "GPS5", "GPS9" and "GLPI" as the camera orders them; STAMPS; {} if there
        are none. A damaged film has what stands before the damage.
    """
    import av

    damaged = (av.FFmpegError, OSError, ValueError, LookupError)
    rotation, found, left = 0, dict[str, list[np.ndarray]](), os.path.getsize(video)
    with contextlib.ExitStack() as opened, contextlib.suppress(*damaged):
        film = open_container(video)
        if film is None:
            return rotation, {}
        opened.enter_context(film)
        with contextlib.suppress(*damaged, StopIteration):
            first = next(film.decode(list_films(film)[0]))
            rotation = -find_quarter_turns(first) % 4 * 90
        film.seek(0)
        tracks = film.streams.data
        for stream in film.streams if hasattr(av.stream, "Discard") else ():  # else read in vain
            if stream.type != "data":
                stream.discard = av.stream.Discard.all
        for packet in film.demux(tracks) if tracks else ():
            left -= packet.size
            if left < 0:  # samples that lie over one another
                break
            if packet.pts is None or packet.size > _MOST_SAMPLE:
                continue
            start = float(packet.pts * packet.time_base)
            length = float((packet.duration or 0) * packet.time_base)
            for name, rows, share in _read_sample(bytes(packet)):
                times = start + length * share
                found.setdefault(name, []).append(np.column_stack([times, rows]))
    return rotation, {
        name: np.concatenate([part for part in parts if part.shape[1] == parts[0].shape[1]])
        for name, parts in found.items()
    }


def _read_sample(data: bytes) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Yields name and rows of a sample's streams, and when in the sample each row was measured."""
    if data.startswith(_GPMF_START):
        for name, rows in read_gpmf(data):
            yield name, rows, np.arange(len(rows)) / len(rows)
        return
    number = struct.unpack_from("<H", data, 2)[0] if len(data) >= 4 else -1
    if number in _CAMM_SENSORS and len(data) >= 4 + struct.calcsize(_CAMM_SENSOR):
        values = struct.unpack_from(_CAMM_SENSOR, data, 4)
        yield _CAMM_SENSORS[number], np.array([values]), np.zeros(1)
    layout, first = _CAMM_PLACES.get(number, ("", 0))
    if layout and len(data) >= 4 + struct.calcsize(layout):
        values = struct.unpack_from(layout, data, 4)
        if not first or values[1] >= _LEAST_FIX:
            yield "GPS5", np.array([values[first : first + 3]]), np.zeros(1)


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
                if rows is not None and wanted in _SENSORS:
                    rows = _turn_axes(rows, held)
                if rows is None or lost:
                    continue
                yield wanted, rows
                stamp = _read_rows(held, "STMP") if "STMP" in held else None
                if wanted == "GYRO" and stamp is not None:
                    yield STAMPS, stamp[:1, :1]


def _turn_axes(rows: np.ndarray, held: dict[str, list]) -> np.ndarray | None:
    """Returns (N, 3) in the camera's axes; None if the file names no such axes.

    ORIN names the axis of each number, ORIO that of each number once MTRX turned it; a small letter
    is one that points the other way.
    """
    key, turned = "ORIN", _read_rows(held, "MTRX") if "MTRX" in held and "ORIO" in held else None
    if turned is not None and turned.size == 9 and rows.shape[1] == 3:
        turned = turned.reshape(3, 3)
        if np.abs(turned @ turned.T - np.eye(3)).max() < _SQUARE:
            key, rows = "ORIO", rows @ turned.T
    names = held[key][3].decode("latin1") if key in held else _AXES
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
        kind *= size // np.dtype(_TYPES[kind]).itemsize
    if not kind or not set(kind) <= _TYPES.keys():
        return None
    layout = np.dtype([(str(i), ">" + _TYPES[each]) for i, each in enumerate(kind)])
    if layout.itemsize != size or not count:
        return None
    table = np.frombuffer(data, layout)
    rows = np.stack([table[name].astype(np.float64) for name in layout.names or ()], axis=1)
    if key in ("GPSF", "SCAL", "STMP", "MTRX") or "SCAL" not in held:
        return rows
    scale = _read_rows(held, "SCAL")
    if scale is None or scale.size not in (1, rows.shape[1]) or not scale.all():
        return None
    return rows / scale.ravel()
