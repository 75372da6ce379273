"""capture.json beside a folder of frames: when each was taken, and what it was taken from."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from gsut.data.text_files import read_json

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
        DatasetError: the file is not JSON.
    """
    path = folder / CAPTURE
    return read_json(path) if path.is_file() else None


def capture_state(paths: Sequence[Path]) -> list[list[Any]]:
    """Lists path, size and time of change of each file, which show whether it is still the same."""
    return [[str(p.resolve()), p.stat().st_size, p.stat().st_mtime_ns] for p in paths]
