"""Steps through the records of COLMAP's files, text or binary, field by field; errors say where."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from gsut.data.errors import DatasetError
from gsut.files import open_text, read_bytes

SENSOR_TYPES = {"INVALID": -1, "CAMERA": 0, "IMU": 1}  # as text, as a number in a binary file
_POINT2D_BYTES = 24  # x, y as double, point id as uint64
_TRACK_BYTES = 8  # image id and 2D point index as uint32
_EXPECTED = {
    "image": "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME",
    "point": "POINT3D_ID X Y Z R G B ERROR TRACK[]",
}


def _parse_byte(word: str) -> int:
    return range(256).index(int(word))


# Fields are named by the letters of `struct`; those that are no whole numbers in text.
_PARSERS: dict[str, Callable[[str], Any]] = {
    "d": float, "i": SENSOR_TYPES.__getitem__, "B": _parse_byte,
}  # fmt: skip


class _TextRecords:
    """The records of a text file, a line each; iterating gives the place of each.

    Args:
        path: the file.
        kind: of its records: "image", "point", "rig" or "frame".
    """

    def __init__(self, path: Path, kind: str) -> None:
        self._path, self._kind, self._where, self._line, self._rest = path, kind, "", "", ""
        self._lines = self._read_lines()

    def _read_lines(self) -> Iterator[str]:
        with open_text(self._path, fails=DatasetError) as file:
            for number, line in enumerate(file, 1):
                if not line.startswith("#"):
                    self._where = f"{self._path}, line {number}"
                    yield line.strip()

    def __iter__(self) -> Iterator[str]:
        for line in filter(None, self._lines):
            self._line = self._rest = line
            yield self._where
            if self._rest:
                raise self._report(_EXPECTED.get(self._kind))

    def _report(self, expected: str | None) -> DatasetError:
        shown = self._line if len(self._line) <= 60 else self._line[:57] + "..."
        return DatasetError(
            self._where,
            f"expected {expected or f'a {self._kind} as COLMAP 4 writes it'}, found '{shown}'",
            "the file may be cut off or edited: export the model again",
        )

    def take(self, fields: str) -> list:
        """Takes the next fields of the record."""
        words = self._rest.split(maxsplit=len(fields))
        self._rest = words.pop() if len(words) > len(fields) else ""
        try:
            pairs = zip(fields, words, strict=True)
            return [_PARSERS.get(field, int)(word) for field, word in pairs]
        except (ValueError, LookupError):
            raise self._report(_EXPECTED.get(self._kind)) from None

    def take_name(self) -> str:
        """Takes the rest of the record, a name."""
        name, self._rest = self._rest, ""
        if not name:
            raise self._report(_EXPECTED[self._kind])
        return name

    def skip_points(self) -> None:
        """Skips an image's 2D points, on a line of their own; checks the last one alone."""
        self._line = next(self._lines, "")
        fields = self._line.rsplit(maxsplit=3)[-3:]
        try:
            if self._line:
                float(fields[0]), float(fields[1]), int(fields[2])
        except (ValueError, IndexError):
            raise self._report(
                "the image's points X Y POINT3D_ID ... (an empty line if it has none)"
            ) from None

    def skip_track(self) -> None:
        """Skips a point's track, the rest of its record."""
        self._rest = ""


class _BinaryRecords:
    """The records of a binary file, with the interface of `_TextRecords`."""

    def __init__(self, path: Path, kind: str) -> None:
        self._data, self._path, self._kind = read_bytes(path), path, kind
        self._position = self._record = self._count = 0
        (self._count,) = self.take("Q")

    def __iter__(self) -> Iterator[str]:
        for record in range(1, self._count + 1):
            self._record = record
            yield f"{self._path}, byte {self._position}"
        if self._position != len(self._data):
            raise DatasetError(
                self._path,
                f"{len(self._data) - self._position} bytes are left after {self._count}"
                f" {self._kind} records, at byte {self._position}",
                "the file may be of another COLMAP version or damaged: export the model again",
            )

    def _advance(self, size: int) -> int:
        """Moves past `size` bytes; returns where they begin."""
        start, self._position = self._position, self._position + size
        if size < 0 or self._position > len(self._data):
            place = f"{self._kind} {self._record} of {self._count}" if self._count else "its header"
            raise DatasetError(
                self._path,
                f"the file ends at byte {len(self._data)}, in {place}, which starts at or before "
                f"byte {start}",
                "copy or export the model again",
            )
        return start

    def take(self, fields: str) -> list:
        layout = struct.Struct(f"<{fields}")
        return list(layout.unpack_from(self._data, self._advance(layout.size)))

    def take_name(self) -> str:
        size = self._data.find(b"\0", self._position) + 1 - self._position
        start = self._advance(size)
        try:
            return self._data[start : self._position - 1].decode("utf-8")
        except UnicodeDecodeError as error:
            raise DatasetError(
                f"{self._path}, {self._kind} {self._record} of {self._count}",
                f"the name at byte {start} is not UTF-8",
                "the file may be damaged: copy or export the model again",
            ) from error

    def skip_points(self) -> None:
        self._advance(self.take("Q")[0] * _POINT2D_BYTES)

    def skip_track(self) -> None:
        self._advance(self.take("Q")[0] * _TRACK_BYTES)


def open_records(path: Path, kind: str) -> _TextRecords | _BinaryRecords:
    """Opens a file of a model, text if it ends as .txt."""
    return (_TextRecords if path.suffix == ".txt" else _BinaryRecords)(path, kind)
