"""Reads how a film's camera turned: gyroscope, orientations of frames, Gyroflow's log beside it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsut.capture.facts import TurnRecord
from gsut.capture.telemetry import STAMPS
from gsut.files import FileError, read_text, register_reader, write_npz
from gsut.gaussians import find_rotation_vectors, rotations_from_quaternions

# Radians a second beyond which no gyroscope of a camera measures.
_MOST_RATE = 40.0
# Seconds between rows beyond which what happened in between is not known.
_LONGEST_GAP = 0.1
# Fewest rows of a record.
_FEWEST = 16
# How far the length of a recorded quaternion may be from one.
_UNIT = 0.05
# How far the camera's clock may run off the film's, as a share.
_CLOCK = 0.05
_TURNS = "turns.npz"  # beside capture.json
# First word of Gyroflow's log, and what stands above its numbers.
_GCSV = "GYROFLOW IMU LOG"
_HEADING = "t,gx,gy,gz"


def find_turn_records(
    video: Path, streams: dict[str, np.ndarray], rotation: int
) -> tuple[tuple[TurnRecord, ...], list[str]]:
    """Finds the records of a film, and what to say of those that are damaged.

    Args:
        video: a log NAME.gcsv beside it stands for its own gyroscope.
        streams: of `read_streams`.
        rotation: degrees clockwise by which frames are turned to be shown.
    """
    rows, notes = streams.get("GYRO", np.zeros((0, 4))), list[str]()
    rows = _follow_clock(rows, streams.get(STAMPS, np.zeros((0, 2))))
    log = video.with_suffix(".gcsv")
    if log.is_file():
        try:
            rows = read_gcsv(log)
        except FileError as error:
            notes.append(f"{error}; this log is left out")
    good = np.isfinite(rows).all(axis=1) & (np.abs(rows[:, 1:]) < _MOST_RATE).all(axis=1)
    if not good.all():
        notes.append(
            f"{video.name}: {np.count_nonzero(~good)} of {len(good)} values of the gyroscope are "
            f"left out: they are beyond {_MOST_RATE:.0f} rad/s or no numbers"
        )
    rows = rows[good]
    rows = rows[np.unique(rows[:, 0], return_index=True)[1]]
    # Between two samples the mean of both.
    mean = np.column_stack([rows[:-1, 0], (rows[:-1, 1:] + rows[1:, 1:]) / 2])
    found = {"gyroscope": np.concatenate([mean, rows[-1:]])}
    found["orientations"] = _find_picture_rates(streams)
    return tuple(
        TurnRecord(source, turn_axes(_mark_gaps(rates), rotation))
        for source, rates in found.items()
        if len(rates) >= _FEWEST
    ), notes


def write_turns(folder: Path, records: Sequence[TurnRecord]) -> dict[str, Any]:
    """Writes records beside capture.json.

    Returns:
        Its "turns": the path from the folder, and of each record "source", "rows", "hertz" and
        "seconds", first and last.
    """
    write_npz(folder / _TURNS, {record.source: record.rates for record in records}, pack=True)
    rows = [
        {
            "source": record.source, "rows": len(record.rates),
            "hertz": 1 / float(np.median(np.diff(record.rates[:, 0]))),
            "seconds": record.rates[[0, -1], 0],
        }
        for record in records
    ]  # fmt: skip
    return {"path": _TURNS, "records": rows}


@register_reader("Gyroflow's log", ".gcsv")
def read_gcsv(path: Path) -> np.ndarray:
    """Reads (N, 4) seconds and rad/s of a log of Gyroflow (.gcsv), in the axes that it names.

    Raises:
        FileError: not such a log, or one without numbers.
    """
    advice = "export the log again, or remove it"
    head, found, body = read_text(path).partition(_HEADING)
    if not head.startswith(_GCSV) or not found:
        raise FileError(path, f"is no log of Gyroflow: it lacks {_GCSV!r} or {_HEADING!r}", advice)
    fields = dict(line.split(",", 1) for line in head.splitlines() if "," in line)
    rows = []
    for line in body.splitlines()[1:]:
        values = line.split(",")[:4]
        if len(values) == 4:
            rows.append([_read_number(value) for value in values])
    scales = [_read_number(fields.get(key, "1")) for key in ("tscale", "gscale")]
    if not rows or not np.isfinite(scales).all():
        raise FileError(path, "has no numbers of a gyroscope", advice)
    table = np.array(rows) * np.repeat(scales, (1, 3))
    axes = fields.get("orientation", "XYZ").strip()
    if sorted(axes.upper()) != ["X", "Y", "Z"]:
        raise FileError(path, f"names the axes {axes[:16]!r}, not three of X, Y and Z", advice)
    signs = [1 if axis.isupper() else -1 for axis in axes]
    order = ["XYZ".index(axis) for axis in axes.upper()]
    table[:, 1:] = table[:, 1:][:, order] * signs
    return table


def _read_number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def _follow_clock(rows: np.ndarray, stamps: np.ndarray) -> np.ndarray:
    """Times rows by the camera's clock, where it runs about as the film does.

    Args:
        rows: (N, 4) timed by the payloads of the film.
        stamps: (M, 2) when a payload begins in the film (seconds), and by the clock (microseconds).
    """
    stamps = stamps[np.isfinite(stamps).all(axis=1)]
    film, clock = stamps[:, 0], stamps[:, 1] / 1e6
    if len(stamps) < 2 or not (np.diff(film) > 0).all():
        return rows
    if (np.abs(np.diff(clock) / np.diff(film) - 1) > _CLOCK).any():
        return rows
    knots = np.append(film, 2 * film[-1] - film[-2])
    moved = np.append(clock, 2 * clock[-1] - clock[-2]) + float(np.median(film - clock))
    return np.column_stack([np.interp(rows[:, 0], knots, moved), rows[:, 1:]])


def _find_picture_rates(streams: dict[str, np.ndarray]) -> np.ndarray:
    """Finds the rates (N, 4) of a stabilised picture from its orientations, a frame each.

    The camera's and the picture's on it: world_from_picture = CORI^-1 IORI^-1.
    """
    camera, picture = (streams.get(name, np.zeros((0, 5))) for name in ("CORI", "IORI"))
    count = min(len(camera), len(picture))
    if count < _FEWEST or camera.shape[1] != 5 or picture.shape[1] != 5:
        return np.zeros((0, 4))
    both = np.stack([camera[:count], picture[:count]])
    good = (np.abs(np.linalg.norm(both[..., 1:], axis=2) - 1) < _UNIT).all(axis=0)
    good &= (both[0, :, 0] == both[1, :, 0]) & np.isfinite(both).all(axis=(0, 2))
    times, first = np.unique(both[0, good, 0], return_index=True)
    if not len(times):
        return np.zeros((0, 4))
    unit = both[:, good][:, first, 1:]
    unit /= np.linalg.norm(unit, axis=2, keepdims=True)
    # In row order: picture_from_world of a frame times world_from_picture of the next one.
    of_camera, of_picture = (rotations_from_quaternions(each) for each in unit)
    picture_from_world = of_picture @ of_camera
    step = picture_from_world[:-1] @ picture_from_world[1:].transpose(0, 2, 1)
    rates = find_rotation_vectors(step) / np.diff(times)[:, None]
    return np.column_stack([times, np.concatenate([rates, np.zeros((1, 3))])])


def _mark_gaps(rates: np.ndarray) -> np.ndarray:
    """Returns rates that are not known where the next row follows late."""
    marked = rates.copy()
    marked[:-1][np.diff(rates[:, 0]) > _LONGEST_GAP, 1:] = np.nan
    return marked


def turn_axes(rows: np.ndarray, rotation: int) -> np.ndarray:
    """Turns vectors (N, 1 + 3) into the axes of frames that are shown turned clockwise."""
    turned = rows.copy()
    for _ in range(rotation // 90):
        turned[:, 1], turned[:, 2] = -turned[:, 2], turned[:, 1].copy()
    return turned
