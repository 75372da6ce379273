"""capture.json beside a folder of frames: when each was taken, and what it was taken from."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gsut.data.errors import DatasetError
from gsut.data.text_files import read_json
from gsut.files import reading

CAPTURE = "capture.json"
CAPTURE_FOLDER = "capture"  # of a video's frames, in the folder of their poses
STRIP = "strip.jpg"  # the pictures side by side, beside capture.json


def read_capture(folder: Path) -> dict[str, Any] | None:
    """Reads FOLDER/capture.json; returns None if there is none.

    "frames" holds one object a picture: name, path (from FOLDER), and where known time (seconds)
    and mask (a path, too); "focal_px" the focal length that the pictures name, "camera" who took
    them, "lens" the lens where the pictures themselves determine it, "fisheye" one to begin with,
    "lenses" the folders of lenses that took pictures of one name together, and "notes" what the
    user should know.

    Raises:
        DatasetError: the file is damaged.
    """
    path = folder / CAPTURE
    if not path.is_file():
        return None
    figures = read_json(path)
    advice = f"remove {path}, and the same command chooses the pictures again"
    with reading(lambda what: DatasetError(path, what, advice)):
        _check_types(figures["frames"], {"name": str, "path": str})
        _check_types([figures], {"inputs": list, "notes": list, "size": list, "key": dict})
        if not figures["frames"] or [type(side) for side in figures["size"]] != [int, int]:
            raise ValueError("no pictures, or pictures without a size")
        for row in figures["key"]["inputs"]:
            _check_types([dict(enumerate(row))], {0: str, 1: int, 2: (int, str)})
    return figures


def _check_types(rows: Any, types: Mapping[Any, type | tuple[type, ...]]) -> None:
    """Raises TypeError or KeyError where one of `rows` lacks a key or has another type."""
    for row in rows:
        for name, kind in types.items():
            if not isinstance(row[name], kind):
                raise TypeError(f"{name} is {type(row[name]).__name__}")
