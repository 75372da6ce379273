"""Reads videos: frames with their time stamps, upright, and what is wrong with a file in words.

By OpenCV, whose decoder is FFmpeg: it turns frames as the file's rotation says, and the time
stamps are those of the file, so that a variable frame rate is no matter.
"""

from __future__ import annotations

import contextlib
import os
import re
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import InputError

VIDEO_SUFFIXES = (".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm", ".mts", ".m2ts", ".360", ".insv")
# GoPro's firmware names since HERO9; before, HD8 is HERO8.
_GOPRO = {
    "HD9": "HERO9", "H19": "Max", "H21": "HERO10", "H22": "HERO11", "H23": "HERO12",
    "H24": "HERO13",
}  # fmt: skip
_METADATA_BYTES = 4_000_000
_CONVERT = "convert it: ffmpeg -i IN -c:v libx264 -crf 16 OUT.mp4"


def is_video(path: str | os.PathLike[str]) -> bool:
    """Whether the name is that of a video."""
    return Path(path).suffix.lower() in VIDEO_SUFFIXES


class Video:
    """An open video.

    Args:
        path: the file.

    Attributes:
        width, height: of the upright frames, pixels.
        frame_rate: frames a second, the mean.
        frame_count: as the file says; 0: it does not.

    Raises:
        InputError: no video, an index that is missing, or a codec that cannot be decoded.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        if not self.path.is_file():
            raise InputError(f"{path}: no such file; give a video or a folder of photographs")
        self._capture = _opened(self.path)
        import cv2

        self.frame_rate = float(self._capture.get(cv2.CAP_PROP_FPS)) or 30.0
        self.frame_count = max(0, int(self._capture.get(cv2.CAP_PROP_FRAME_COUNT)))
        self.width = int(self._capture.get(cv2.CAP_PROP_FRAME_WIDTH))
        self.height = int(self._capture.get(cv2.CAP_PROP_FRAME_HEIGHT))

    def frames(self) -> Iterator[tuple[int, float, Any]]:
        """Yields (number, seconds, picture) of every frame, once.

        `picture()` decodes the frame just yielded to (H, W, 3) uint8 BGR, or None if it is damaged.
        """
        import cv2

        number = 0
        while self._capture.grab():
            seconds = self._capture.get(cv2.CAP_PROP_POS_MSEC) / 1000
            yield number, seconds, self._picture
            number += 1

    def _picture(self) -> np.ndarray | None:
        read, picture = self._capture.retrieve()
        return picture if read else None

    def close(self) -> None:
        self._capture.release()

    def __enter__(self) -> Video:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _opened(path: Path) -> Any:
    import cv2

    with _quiet():
        capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
        opened = capture.isOpened()
    if opened and int(capture.get(cv2.CAP_PROP_FRAME_WIDTH)) > 0:
        return capture
    if _lacks_index(path):
        raise InputError(
            f"{path}: the video was cut off before its index (no 'moov') was written, so no "
            "frame of it can be found; copy it from the camera again, or let the camera repair it"
        )
    raise InputError(
        f"{path}: cannot be decoded as a video: it is damaged, or its codec is not known here; "
        + _CONVERT
    )


def camera_in(path: Path) -> str:
    """The camera's name for `find_lenses`, where the metadata of an MP4 or MOV has one; else ""."""
    size = path.stat().st_size
    with open(path, "rb") as file:  # the index stands at the beginning or at the end
        data = file.read(_METADATA_BYTES)
        if size > len(data):
            file.seek(max(len(data), size - _METADATA_BYTES))
            data += file.read()
    firmware = re.search(rb"FIRM(HD\d+|H\d\d)\.", data)
    if firmware:
        code = firmware[1].decode()
        return f"GoPro {_GOPRO.get(code, code.replace('HD', 'HERO'))}"
    apple = re.search(rb"(iPhone|iPad) ?[A-Za-z0-9 ]{0,16}", data)
    return f"Apple {apple[0].decode().strip()}" if apple else ""


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """OpenCV and FFmpeg say nothing meanwhile: what is wrong is said once, by us."""
    import cv2

    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    before = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        cv2.utils.logging.setLogLevel(before)


def _lacks_index(path: Path) -> bool:
    """Whether an MP4 or MOV has no 'moov' box: cameras write it when recording ends."""
    kinds = []
    with open(path, "rb") as file:
        size = path.stat().st_size
        while file.tell() + 8 <= size:
            start = file.tell()
            length, kind = struct.unpack(">I4s", file.read(8))
            if length == 1:
                length = struct.unpack(">Q", file.read(8).ljust(8, b"\0"))[0]
            kinds.append(kind)
            if length < 8:
                break
            file.seek(start + length)
    return bool(kinds) and kinds[0] in (b"ftyp", b"mdat", b"wide") and b"moov" not in kinds
