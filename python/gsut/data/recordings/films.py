"""Writes recordings as films, one a camera, for poses and scenes where no poses were recorded."""

from __future__ import annotations

import fractions
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.data.poses import NANOSECONDS, to_nanoseconds
from gsut.data.recordings.pairing import find_in_range
from gsut.data.recordings.recording import Recording
from gsut.lens import save_camera

FILMS = "films"
_TICKS = 1_000_000  # of a film's clock, a second


def write_films(recording: Recording, out: Path) -> list[str]:
    """Writes CAMERA.mov and, where its lens is known, CAMERA.lens.json for each camera.

    The pictures are taken over as they are: a film of JPEG or PNG loses nothing.

    Args:
        recording: its pictures have times.
        out: an existing folder.

    Returns:
        How to go on, one sentence a camera.

    Raises:
        InputError: pictures cannot be read, or fewer than two have a time.
    """
    notes = list(recording.notes)
    for stream in recording.streams:
        times = to_nanoseconds(stream.list_times(), recording.image_times or "ns")
        used = np.ones(len(times), bool)
        if recording.time_range is not None:
            used[:] = find_in_range(times.tolist(), recording.time_range, recording.path)
        film, lens = out / f"{stream.name}.mov", out / f"{stream.name}.lens.json"
        _write_film(film, [stream.images[i] for i in np.flatnonzero(used)], times[used])
        try:
            mounts = recording.mounts([stream.name]) if recording.mounts is not None else {}
            save_camera(mounts[stream.name].camera, lens)
            flag = f" --camera {lens.name}"
        except (InputError, KeyError) as error:
            notes.append(f"{stream.name}: no lens ({error}); it is estimated with the poses")
            flag = ""
        notes.append(f"{used.sum()} pictures; to go on: gsut scene {film.name}{flag} -o SCENE")
    return notes


def _write_film(path: Path, images: Sequence[Path], times: np.ndarray) -> None:
    """Puts encoded pictures into a film at their times (nanoseconds), in the order of time."""
    import av

    if len(set(times.tolist())) < 2:
        raise InputError(f"{path.stem}: a film needs pictures of two times at least")
    ticks, first = np.unique((times - times.min()) * _TICKS // NANOSECONDS, return_index=True)
    steps = np.diff(ticks)
    # By open files: FFmpeg reads more into names than files.
    with (
        images[0].open("rb") as start, av.open(start) as picture,
        path.open("wb") as file, av.open(file, "w", format="mov") as film,
    ):  # fmt: skip
        stream: Any = film.add_stream_from_template(picture.streams.video[0])
        stream.time_base = fractions.Fraction(1, _TICKS)
        for tick, index, step in zip(ticks, first, [*steps, np.median(steps)], strict=True):
            packet = av.Packet(images[index].read_bytes())
            packet.stream = stream
            packet.time_base = stream.time_base
            packet.pts = packet.dts = int(tick)
            packet.duration = int(step)  # without it players leave out the last picture
            packet.is_keyframe = True
            film.mux(packet)
