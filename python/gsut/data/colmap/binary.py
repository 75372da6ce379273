"""Reads COLMAP's images.bin and points3D.bin; errors name the byte and the record."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from gsut.data.colmap.records import ImageRow
from gsut.data.errors import DatasetError
from gsut.files import read_bytes

_COUNT = struct.Struct("<Q")
_IMAGE = struct.Struct("<I4d3dI")  # id, quaternion, translation, camera id; then the name and a 0
_POINT2D_BYTES = 24  # x, y as double, point id as uint64
_POINT = struct.Struct("<Q3d3BdQ")  # id, position, colour, error, length of the track
_TRACK_BYTES = 8  # image id and 2D point index as uint32


class ModelReader:
    """Steps through a file's bytes and knows which record it is in."""

    def __init__(self, path: Path, kind: str) -> None:
        self.data = read_bytes(path)
        self.path, self.kind, self.position = path, kind, 0
        self.record, self.count = 0, 0
        self.count = self.unpack(_COUNT)[0]

    def report_truncated(self) -> DatasetError:
        place = f"in {self.kind} {self.record} of {self.count}" if self.count else "in its header"
        return DatasetError(
            self.path,
            f"the file ends at byte {len(self.data)}, {place}, which starts at or before byte"
            f" {self.position}",
            "copy or export the model again",
        )

    def unpack(self, layout: struct.Struct) -> tuple:
        """Reads the next values, laid out as `layout` says."""
        if self.position + layout.size > len(self.data):
            raise self.report_truncated()
        values = layout.unpack_from(self.data, self.position)
        self.position += layout.size
        return values

    def skip(self, size: int) -> None:
        """Moves past `size` bytes."""
        if self.position + size > len(self.data):
            raise self.report_truncated()
        self.position += size

    def name(self) -> str:
        end = self.data.find(b"\0", self.position)
        if end < 0:
            raise self.report_truncated()
        text = self.data[self.position : end]
        self.position = end + 1
        try:
            return text.decode("utf-8")
        except UnicodeDecodeError as error:
            raise DatasetError(
                f"{self.path}, {self.kind} {self.record} of {self.count}",
                f"the name at byte {self.position - len(text) - 1} is not UTF-8",
                "the file may be damaged: copy or export the model again",
            ) from error

    def count_records(self) -> Iterator[int]:
        """Counts through the records, then makes sure that nothing is left."""
        for record in range(1, self.count + 1):
            self.record = record
            yield record
        if self.position != len(self.data):
            raise DatasetError(
                self.path,
                f"{len(self.data) - self.position} bytes are left after {self.count}"
                f" {self.kind} records, at byte {self.position}",
                "the file may be of another COLMAP version or damaged: export the model again",
            )


def read_images_bin(path: Path) -> list[ImageRow]:
    """Reads the images of a binary model without their 2D points.

    Raises:
        DatasetError: truncated, or a name that is not UTF-8.
    """
    reader, rows = ModelReader(path, "image"), []
    for _ in reader.count_records():
        start = reader.position
        image_id, *pose, camera_id = reader.unpack(_IMAGE)
        name = reader.name()
        reader.skip(reader.unpack(_COUNT)[0] * _POINT2D_BYTES)
        where = f"{path}, byte {start}"
        rows.append(ImageRow(image_id, pose[:4], pose[4:], camera_id, name, where))
    return rows


def read_points_bin(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Reads the points of a binary model: (N, 3) float64 and (N, 3) uint8 RGB.

    Raises:
        DatasetError: truncated.
    """
    reader, points, colors = ModelReader(path, "point"), [], []
    for _ in reader.count_records():
        _, x, y, z, red, green, blue, _, track = reader.unpack(_POINT)
        reader.skip(track * _TRACK_BYTES)
        points.append((x, y, z))
        colors.append((red, green, blue))
    return np.array(points, np.float64).reshape(-1, 3), np.array(colors, np.uint8).reshape(-1, 3)
