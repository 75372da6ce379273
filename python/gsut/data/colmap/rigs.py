"""Reads rigs and frames of a COLMAP 4 model, as text or binary, and writes them as binary."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from gsut.data.colmap.binary import ModelReader
from gsut.data.colmap.text import read_lines, report_malformed

_CAMERA = "CAMERA"
_SENSOR_TYPES = {"INVALID": -1, _CAMERA: 0, "IMU": 1}  # as text, as a number in a binary file
# Fields by the letters of `struct`; i is a sensor's type, a word in text.
_HEAD = "II"  # rig, count of sensors; or frame, rig
_SENSOR = "iI"  # type, id
_HAS_POSE = "B"
_POSE = "ddddddd"  # quaternion w, x, y, z and translation
_DATA = "iIQ"  # a sensor's type and id, image id

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


class _TextReader:
    """Steps through the words of a text file's lines as `ModelReader` does through bytes."""

    def __init__(self, path: Path, kind: str) -> None:
        self.path, self.kind, self.where, self.line = path, kind, "", ""
        self.words: Iterator[str] = iter(())

    def report_malformed(self) -> Exception:
        return report_malformed(self.where, self.line, f"a {self.kind} as COLMAP 4 writes it")

    def count_records(self) -> Iterator[int]:
        for number, line in read_lines(self.path):
            if line:
                self.line, self.where = line, f"{self.path}, line {number}"
                self.words = iter(line.split())
                yield number
                if next(self.words, None) is not None:
                    raise self.report_malformed()

    def take(self, fields: str) -> list:
        try:
            return [self._parse(field, next(self.words)) for field in fields]
        except (ValueError, KeyError, StopIteration):
            raise self.report_malformed() from None

    @staticmethod
    def _parse(field: str, word: str) -> float:
        if field == "i":
            return _SENSOR_TYPES[word]
        return float(word) if field == "d" else int(word)


class _BinaryReader(ModelReader):
    @property
    def where(self) -> str:
        return f"{self.path}, {self.kind} {self.record}"

    def take(self, fields: str) -> list:
        return list(self.unpack(struct.Struct(f"<{fields}")))


def _open_reader(path: Path, kind: str) -> _TextReader | _BinaryReader:
    return _TextReader(path, kind) if path.suffix == ".txt" else _BinaryReader(path, kind)


def read_rigs(path: Path) -> list[RigRow]:
    """Reads rigs.txt or rigs.bin; sensors that are no cameras are left out.

    Raises:
        DatasetError: truncated, or a malformed line.
    """
    reader, rows = _open_reader(path, "rig"), []
    for _ in reader.count_records():
        rig, count = reader.take(_HEAD)
        cameras: dict[int, Pose | None] = {}
        for number in range(count):
            kind, sensor = reader.take(_SENSOR)
            pose: Pose | None = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
            if number:
                pose = reader.take(_POSE) if reader.take(_HAS_POSE)[0] else None
            if kind == _SENSOR_TYPES[_CAMERA]:
                cameras[sensor] = pose
        rows.append(RigRow(rig, cameras, reader.where))
    return rows


def read_frames(path: Path) -> list[FrameRow]:
    """Reads frames.txt or frames.bin; data that are no pictures are left out.

    Raises:
        DatasetError: truncated, or a malformed line.
    """
    reader, rows = _open_reader(path, "frame"), []
    for _ in reader.count_records():
        frame, rig = reader.take(_HEAD)
        pose = reader.take(_POSE)
        data = [reader.take(_DATA) for _ in range(reader.take("I")[0])]
        images = [(camera, image) for kind, camera, image in data if kind == _SENSOR_TYPES[_CAMERA]]
        rows.append(FrameRow(frame, rig, pose, images, reader.where))
    return rows


def _list_fields(row: RigRow | FrameRow) -> Iterator[tuple[str, Sequence]]:
    """Lists a record's fields: letters as `take` has them, and their values."""
    camera = _SENSOR_TYPES[_CAMERA]
    if isinstance(row, FrameRow):
        yield _HEAD, (row.frame_id, row.rig_id)
        yield _POSE, row.rig_from_world
        yield "I", (len(row.images),)
        for sensor, image in row.images:
            yield _DATA, (camera, sensor, image)
        return
    yield _HEAD, (row.rig_id, len(row.cameras))
    for number, (sensor, pose) in enumerate(row.cameras.items()):
        yield _SENSOR, (camera, sensor)
        if number:
            yield _HAS_POSE, (int(pose is not None),)
            if pose is not None:
                yield _POSE, pose


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
