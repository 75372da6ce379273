"""Reads COLMAP's images.txt and points3D.txt; errors name the line."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from gsut.data.colmap.records import ImageRow
from gsut.data.errors import DatasetError
from gsut.files import open_text

_IMAGE_FIELDS = 10  # IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME
_POINT_FIELDS = 8  # POINT3D_ID X Y Z R G B ERROR, then the track


def read_lines(path: Path) -> Iterator[tuple[int, str]]:
    """Yields line numbers from 1 and text, without comments; blank lines are kept."""
    with open_text(path, fails=DatasetError) as file:
        for number, line in enumerate(file, 1):
            if not line.startswith("#"):
                yield number, line.strip()


def report_malformed(where: str, line: str, expected: str) -> DatasetError:
    place_and_show = line if len(line) <= 60 else line[:57] + "..."
    return DatasetError(
        where,
        f"expected {expected}, found '{place_and_show}'",
        "the file may be cut off or edited: export the model again",
    )


def read_images_txt(path: Path) -> list[ImageRow]:
    """Reads the images of a text model without the second line of each, its 2D points.

    Raises:
        DatasetError: a malformed line, or an image without its second line.
    """
    rows = []
    expected = "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME"
    lines = read_lines(path)
    for number, line in lines:
        if not line:
            continue
        fields, where = line.split(maxsplit=_IMAGE_FIELDS - 1), f"{path}, line {number}"
        try:
            if len(fields) != _IMAGE_FIELDS:
                raise ValueError
            numbers = [float(field) for field in fields[1:8]]
            rows.append(
                ImageRow(int(fields[0]), numbers[:4], numbers[4:], int(fields[8]), fields[9], where)
            )
        except ValueError as error:
            raise report_malformed(where, line, expected) from error
        number, points = next(lines, (number + 1, ""))
        _require_points_line(points, f"{path}, line {number}")
    return rows


def _require_points_line(line: str, where: str) -> None:
    """Requires X, Y, POINT3D_ID triples; checks only the last one, to stay fast."""
    fields = line.rsplit(maxsplit=3)[-3:]
    try:
        if line:
            float(fields[0]), float(fields[1]), int(fields[2])
    except (ValueError, IndexError) as error:
        raise report_malformed(
            where, line, "the image's points X Y POINT3D_ID ... (an empty line if it has none)"
        ) from error


def read_points_txt(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Reads the points of a text model: (N, 3) float64 and (N, 3) uint8 RGB.

    Raises:
        DatasetError: a malformed line.
    """
    points, colors = [], []
    for number, line in read_lines(path):
        if not line:
            continue
        fields = line.split(maxsplit=_POINT_FIELDS)
        try:
            if len(fields) < _POINT_FIELDS:
                raise ValueError
            points.append([float(field) for field in fields[1:4]])
            color = [int(field) for field in fields[4:7]]
            if not all(0 <= value <= 255 for value in color):
                raise ValueError
            colors.append(color)
        except ValueError as error:
            raise report_malformed(
                f"{path}, line {number}", line, "POINT3D_ID X Y Z R G B ERROR TRACK[]"
            ) from error
    return np.array(points, np.float64).reshape(-1, 3), np.array(colors, np.uint8).reshape(-1, 3)
