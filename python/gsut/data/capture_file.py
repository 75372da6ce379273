"""capture.json beside a folder of frames: when each was taken, and what it was taken from."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from gsut.data.errors import DatasetError
from gsut.files import read_json, reading, register_reader

CAPTURE = "capture.json"
CAPTURE_FOLDER = "capture"  # of a video's frames, in the folder of their poses
_NOTHING = type(None)
_NUMBER = (int, float, _NOTHING)
_SHAPE: dict[str, Any] = {  # what is read of capture.json, see `check_shape`
    "key": {"inputs": [[(str, int)]]}, "inputs": [str], "notes": [str], "size": [int],
    "camera?": (str, _NOTHING), "focal_px?": _NUMBER, "name_rate?": _NUMBER,
    "lenses?": (_NOTHING, [str]), "lens?": (_NOTHING, dict), "fisheye?": (_NOTHING, dict),
    "turns?": {"path": str, "records": [{"source": str}]},
    "frames": [{
        "name": str, "path": str, "mask?": (str, _NOTHING), "time?": _NUMBER,
        "place?": (_NOTHING, [_NUMBER]), "flow?": (_NOTHING, [[_NUMBER]]),
        "orientation?": (int, _NOTHING), "blurred?": (bool, _NOTHING),
    }],
}  # fmt: skip
STRIP = "strip.jpg"  # the pictures side by side, beside capture.json


@register_reader("capture.json", ".json", fails=DatasetError)
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
    advice = f"remove {path}, and the same command chooses the pictures again"
    with reading(path, advice, DatasetError):
        figures = read_json(path, _SHAPE, advice=advice)
        _, _ = figures["size"]
        for _, _, _ in figures["key"]["inputs"]:
            pass
    return figures
