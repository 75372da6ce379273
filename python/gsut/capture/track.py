"""Reads where a film's camera was and what it felt: sensors in the file, subtitles beside it."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from gsut.capture.facts import FilmFacts
from gsut.capture.telemetry import SENSOR_ACCL, read_streams
from gsut.capture.turns import find_turn_records, turn_axes
from gsut.capture.video import read_camera_name
from gsut.files import open_binary, register_reader

# Streams of positions, the best first, and the columns of latitude, longitude and altitude (m):
# of HERO11 and later, of HERO5 to 10, and of drones.
_STREAMS = {"GPS9": (1, 2, 3), "GPS5": (1, 2, 3), "GLPI": (2, 3, 4)}
# Fewest positions of a track.
_FEWEST = 2
# Altitudes in metres that films are taken at.
_ALTITUDE = -500.0, 60_000.0
# Accelerations in m/s^2 beyond which a sensor measured none.
_MOST_FORCE = 200.0
# Seconds over which a hand's or a drone's own acceleration averages out.
_SPAN = 1.0
# Bytes of subtitles that are read: hours of flight have less.
_MOST_SUBTITLES = 64 << 20
# The time of a subtitle, which ends at a blank line.
_TIME = re.compile(r"(\d{1,3}):(\d{1,2}):(\d{1,2})[,.](\d{1,9}) *-->")
# Words that precede latitude, longitude and altitude; one is misspelt by DJI.
_NAMES = ("latitude",), ("longitude", "longtitude"), ("abs_alt", "altitude", "rel_alt")
# A number after such a word.
_NUMBER = r"\s*(?::\s*)?(-?\d{1,9}(?:\.\d{0,15})?)"
# Older drones write GPS(longitude, latitude, satellites or altitude) and the barometer's altitude.
_GPS = re.compile(rf"\bGPS\s?\({_NUMBER}\s?,{_NUMBER}(?:\s?,{_NUMBER})?")
_BAROMETER = re.compile(rf"\bBAROMETER{_NUMBER}")


@register_reader("sensors of a film", ".mp4", ".mov", ".srt")
def read_film_facts(video: Path) -> FilmFacts:
    """Reads what a camera wrote about a film.

    Args:
        video: an MP4 or MOV; of a drone, with NAME.SRT beside it. Of other films only the
            subtitles, and NAME.gcsv by Gyroflow, are read.
    """
    rotation, streams = read_streams(video)
    # A log of Gyroflow has a gyroscope, and axes, of its own.
    is_askew = SENSOR_ACCL in streams and not video.with_suffix(".gcsv").is_file()
    forces = streams.get(SENSOR_ACCL if is_askew else "ACCL", np.zeros((0, 4)))
    good = np.isfinite(forces).all(axis=1) & (np.abs(forces[:, 1:]) < _MOST_FORCE).all(axis=1)
    track, note = _find_track(video, streams)
    turns, damages = find_turn_records(video, streams, rotation)
    return FilmFacts(
        read_camera_name(video), rotation, track, turn_axes(forces[good], rotation), is_askew,
        turns, tuple(filter(None, [note, *damages])),
    )  # fmt: skip


def _find_track(video: Path, streams: dict[str, np.ndarray]) -> tuple[np.ndarray, str]:
    """Finds (N, 4) seconds, latitude, longitude and altitude, (0, 4) if there are no places; and
    what to say of subtitles that have none.
    """
    note = ""
    for suffix in (".SRT", ".srt"):
        subtitles = video.with_suffix(suffix)
        if subtitles.is_file():
            with open_binary(subtitles) as file:
                text = file.read(_MOST_SUBTITLES).decode("utf-8", "replace")
            track = _drop_implausible(_parse_subtitles(text))
            if len(track):
                return track, ""
            note = f"{subtitles.name}: no positions are found in these subtitles (SRT)"
    for name, columns in _STREAMS.items():
        rows = streams.get(name, np.zeros((0, 5)))
        if rows.shape[1] <= max(columns):
            continue
        rows = _drop_implausible(rows[:, [0, *columns]])
        if len(rows) >= _FEWEST:
            return rows, ""
    return np.zeros((0, 4)), note


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


def average_ups(
    forces: np.ndarray, times: np.ndarray, span: float = _SPAN
) -> list[tuple[float, float, float] | None]:
    """Returns the direction that was up in the camera's axes, on average around each time.

    Over seconds the camera's own acceleration averages out, and what is felt points up.

    Args:
        forces: (M, 4) of `FilmFacts`.
        times: (N,) seconds.
        span: seconds that are averaged.
    """
    ups: list[tuple[float, float, float] | None] = []
    for time in times:
        first, last = np.searchsorted(forces[:, 0], (time - span / 2, time + span / 2))
        mean = forces[first:last, 1:].mean(axis=0) if last > first else np.zeros(3)
        length = float(np.linalg.norm(mean))
        x, y, z = mean / length if length > 0 else mean
        ups.append((float(x), float(y), float(z)) if length > 0 else None)
    return ups


def _drop_implausible(rows: np.ndarray) -> np.ndarray:
    """Sorts rows by time and drops impossible ones and 0, 0, which means that there was no fix."""
    good = np.isfinite(rows).all(axis=1) & (np.abs(rows[:, 1]) <= 90) & (np.abs(rows[:, 2]) <= 180)
    good &= (rows[:, 1] != 0) | (rows[:, 2] != 0)
    good &= (rows[:, 3] >= _ALTITUDE[0]) & (rows[:, 3] <= _ALTITUDE[1])
    rows = rows[good]
    return rows[np.argsort(rows[:, 0], kind="stable")]


def _split_subtitles(text: str) -> Iterator[tuple[re.Match[str], str]]:
    """Yields the time of each subtitle and its text, which ends at a blank line."""
    time, lines = None, list[str]()
    for line in itertools.chain(text.split("\n"), [""]):
        if line.strip():
            time = time or _TIME.search(line)
            lines.append(line)
            continue
        if time is not None:
            yield time, "\n".join(lines)
        time, lines = None, []


def _parse_subtitles(text: str) -> np.ndarray:
    rows = []
    for stated, cue in _split_subtitles(text):
        hours, minutes, seconds, part = stated.groups()
        time = 3600 * int(hours) + 60 * int(minutes) + int(seconds) + float(f"0.{part}")
        values = [
            next(filter(None, (re.search(rf"\b{n}{_NUMBER}", cue, re.I) for n in names)), None)
            for names in _NAMES
        ]
        numbers = [value[1] for value in values if value]
        gps = _GPS.search(cue)
        if len(numbers) < len(values) and gps is not None:
            height = _BAROMETER.search(cue)
            numbers = [gps[2], gps[1], height[1] if height else gps[3] or "0"]
        if len(numbers) == len(values):
            rows.append([time, *map(float, numbers)])
    return np.array(rows, np.float64).reshape(-1, 4)
