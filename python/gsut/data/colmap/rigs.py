"""Reads and writes the rigs of a COLMAP 4 model: rigs and frames, as text or binary."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from gsut.data.colmap.fields import SENSOR_TYPES, open_records

_CAMERA = SENSOR_TYPES["CAMERA"]
# Fields by the letters of `struct`; i is a sensor's type, a word in text.
_HEAD = "II"  # rig, count of sensors; or frame, rig
_SENSOR = "iI"  # type, id
_HAS_POSE = "B"
_POSE = "ddddddd"  # quaternion w, x, y, z and translation
_DATA = "iIQ"  # a sensor's type and id, image id

_RIGS_TEXT = "# RIG_ID, NUM_SENSORS, REF_SENSOR_TYPE, REF_SENSOR_ID, SENSORS[] as (SENSOR_TYPE, SENSOR_ID, HAS_POSE, [QW, QX, QY, QZ, TX, TY, TZ])"  # fmt: skip # noqa: E501
_FRAMES_TEXT = "# FRAME_ID, RIG_ID, RIG_FROM_WORLD[QW, QX, QY, QZ, TX, TY, TZ], NUM_DATA_IDS, DATA_IDS[] as (SENSOR_TYPE, SENSOR_ID, DATA_ID)"  # fmt: skip # noqa: E501

Pose = Sequence[float]  # target-from-source: quaternion w, x, y, z and translation


class RigRow(NamedTuple):
    """One rig: camera_from_rig by camera id, None where it is not known; the first is its origin.

    `where` names the place in the file.
    """

    rig_id: int
    cameras: dict[int, Pose | None]
    where: str = ""


class FrameRow(NamedTuple):
    """One instant of a rig: its pose, and the pictures taken as (camera id, image id)."""

    frame_id: int
    rig_id: int
    rig_from_world: Pose
    images: list[tuple[int, int]]
    where: str = ""


def read_rigs(path: Path) -> list[RigRow]:
    """Reads rigs.txt or rigs.bin; sensors that are no cameras are left out.

    Raises:
        DatasetError: truncated, or a malformed line.
    """
    records, rows = open_records(path, "rig"), []
    for where in records:
        rig, count = records.take(_HEAD)
        cameras: dict[int, Pose | None] = {}
        for number in range(count):
            kind, sensor = records.take(_SENSOR)
            pose: Pose | None = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
            if number:
                pose = records.take(_POSE) if records.take(_HAS_POSE)[0] else None
            if kind == _CAMERA:
                cameras[sensor] = pose
        rows.append(RigRow(rig, cameras, where))
    return rows


def read_frames(path: Path) -> list[FrameRow]:
    """Reads frames.txt or frames.bin; data that are no pictures are left out.

    Raises:
        DatasetError: truncated, or a malformed line.
    """
    records, rows = open_records(path, "frame"), []
    for where in records:
        frame, rig = records.take(_HEAD)
        pose = records.take(_POSE)
        data = [records.take(_DATA) for _ in range(records.take("I")[0])]
        images = [(camera, image) for kind, camera, image in data if kind == _CAMERA]
        rows.append(FrameRow(frame, rig, pose, images, where))
    return rows


def _list_fields(row: RigRow | FrameRow) -> Iterator[tuple[str, Sequence]]:
    """Lists a record's fields: letters as `take` has them, and their values."""
    if isinstance(row, FrameRow):
        yield _HEAD, (row.frame_id, row.rig_id)
        yield _POSE, row.rig_from_world
        yield "I", (len(row.images),)
        for sensor, image in row.images:
            yield _DATA, (_CAMERA, sensor, image)
        return
    yield _HEAD, (row.rig_id, len(row.cameras))
    for number, (sensor, pose) in enumerate(row.cameras.items()):
        yield _SENSOR, (_CAMERA, sensor)
        if number:
            yield _HAS_POSE, (int(pose is not None),)
            if pose is not None:
                yield _POSE, pose


def format_rig_texts(rigs: Sequence[RigRow], frames: Sequence[FrameRow]) -> dict[str, str]:
    """Formats rigs.txt and frames.txt."""

    def format_row(row: RigRow | FrameRow) -> str:
        return " ".join(
            "CAMERA" if field == "i" else repr(float(value) if field == "d" else int(value))
            for fields, values in _list_fields(row)
            for field, value in zip(fields, values, strict=True)
        )

    files: dict[str, tuple[str, Sequence[RigRow | FrameRow]]]
    files = {"rigs.txt": (_RIGS_TEXT, rigs), "frames.txt": (_FRAMES_TEXT, frames)}
    return {
        name: "\n".join([head, *map(format_row, rows), ""]) for name, (head, rows) in files.items()
    }


def pack_rigs(rigs: Sequence[RigRow], frames: Sequence[FrameRow]) -> dict[str, bytes]:
    """Packs rigs.bin and frames.bin."""
    files: dict[str, Sequence[RigRow | FrameRow]] = {"rigs.bin": rigs, "frames.bin": frames}
    return {
        name: struct.pack("<Q", len(rows))
        + b"".join(
            struct.pack(f"<{fields}", *values)
            for row in rows
            for fields, values in _list_fields(row)
        )
        for name, rows in files.items()
    }
