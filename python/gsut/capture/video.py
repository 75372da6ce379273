"""Reads videos: upright frames with their time stamps, and sentences on what is wrong with a file.

OpenCV, whose decoder is FFmpeg, rotates frames according to the file and gives the file's time
stamps, so that a variable frame rate does not matter. The second of two lenses, in a stream or file
of its own, is read by PyAV, since OpenCV reads the first stream only.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import re
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.files import check_regular

VIDEO_SUFFIXES = (".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm", ".mts", ".m2ts", ".360", ".insv")
# GoPro's firmware names since HERO9; before, HD8 is HERO8.
_GOPRO = {
    "HD9": "HERO9", "H19": "Max", "H21": "HERO10", "H22": "HERO11", "H23": "HERO12",
    "H24": "HERO13",
}  # fmt: skip
# Bytes at either end of a file that are searched for the camera's name.
_METADATA_BYTES = 4_000_000
# Advice for a codec that cannot be decoded.
_CONVERT = "convert it: ffmpeg -i IN -c:v libx264 -crf 16 OUT.mp4"


def is_video(path: str | os.PathLike[str]) -> bool:
    """Returns whether the name is that of a video."""
    return Path(path).suffix.lower() in VIDEO_SUFFIXES


class Video:
    """Reads an open video.

    Args:
        path: the file.
        beside: file of the other lens of a 360-degree camera, or None; the file itself: its second
            stream.

    Attributes:
        width, height: of the upright frames in pixels; frames of two lenses are side by side.
        frame_rate: mean number of frames per second.
        frame_count: according to the file; 0 if it does not say.
        untimed: frames read so far whose time stamps do not rise; the frame rate times them.

    Raises:
        InputError: no video, a missing index, or a codec that cannot be decoded.
    """

    def __init__(
        self, path: str | os.PathLike[str], beside: str | os.PathLike[str] | None = None
    ) -> None:
        self.path = Path(path)
        if not self.path.is_file():
            raise InputError(f"{path}: no such file; give a video or a folder of photographs")
        self._capture = _open_video(self.path)
        import cv2

        self._other: Iterator[Any] | None = None
        self._beside: Any = None  # the frame of the other lens
        if beside is not None:
            self._other = _decode_stream(Path(beside), int(Path(beside) == self.path))
            self._capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)  # the other one is not turned
        self.frame_rate = float(self._capture.get(cv2.CAP_PROP_FPS)) or 30.0
        self.frame_count = max(0, int(self._capture.get(cv2.CAP_PROP_FRAME_COUNT)))
        self.untimed = 0
        self.width = int(self._capture.get(cv2.CAP_PROP_FRAME_WIDTH))
        self.height = int(self._capture.get(cv2.CAP_PROP_FRAME_HEIGHT))
        if self._other is not None:
            self.width *= 2

    def read_frames(self) -> Iterator[tuple[int, float, Any]]:
        """Yields (number, seconds, decode) of every frame, once; seconds rise.

        `decode()` returns the frame just yielded as (H, W, 3) uint8 BGR, or None if it is damaged.
        """
        import cv2

        number, last = 0, -1 / self.frame_rate
        while self._capture.grab():
            seconds = self._capture.get(cv2.CAP_PROP_POS_MSEC) / 1000
            if not seconds > last:
                seconds = last + 1 / self.frame_rate
                self.untimed += 1
            last = seconds
            if self._other is not None:
                self._beside = next(self._other, None)
                if self._beside is None:
                    return
            yield number, seconds, self._decode_picture
            number += 1

    def _decode_picture(self) -> np.ndarray | None:
        read, picture = self._capture.retrieve()
        if not read or self._other is None:
            return picture if read else None
        beside = self._beside.to_ndarray(format="bgr24")
        return np.hstack([picture, beside]) if beside.shape == picture.shape else None

    def close(self) -> None:
        self._capture.release()

    def __enter__(self) -> Video:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def read_stream_start(
    path: Path, stream: int, count: int
) -> tuple[np.ndarray, tuple[Any, ...]] | None:
    """Reads the first frames of a stream of a video, and what two lenses of one camera share.

    Returns:
        (N, H, W, 3) uint8, N at most `count`, with size, number and rate of the frames; None if
        there is no such stream, or no frame in it can be decoded.
    """
    import av

    try:
        with av.open(str(check_regular(path))) as container:
            streams = container.streams.video
            if stream >= len(streams):
                return None
            of = streams[stream]
            size = of.codec_context.width, of.codec_context.height
            about = size, of.frames, of.average_rate
            frames = itertools.islice(container.decode(video=stream), count)
            pictures = [frame.to_ndarray(format="bgr24") for frame in frames]
    except (av.FFmpegError, OSError):
        return None  # reading the frames reports what is wrong with the file
    return (np.array(pictures), about) if pictures else None


def _decode_stream(path: Path, stream: int) -> Iterator[Any]:
    import av

    with contextlib.suppress(av.FFmpegError), av.open(str(path)) as container:  # ends where damaged
        yield from container.decode(video=stream)


def _open_video(path: Path) -> Any:
    import cv2

    with _silence():
        capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
        opened = capture.isOpened()
    if opened and int(capture.get(cv2.CAP_PROP_FRAME_WIDTH)) > 0:
        return capture
    if _is_without_index(path):
        raise InputError(
            f"{path}: the video was cut off before its index (no 'moov') was written, so no "
            "frame of it can be found; copy it from the camera again, or let the camera repair it"
        )
    raise InputError(
        f"{path}: cannot be decoded as a video: it is damaged, or its codec is not known here; "
        + _CONVERT
    )


def read_camera_name(path: Path) -> str:
    """Reads the camera's name for `find_lenses` from an MP4 or MOV; "" if it has none."""
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
def _silence() -> Iterator[None]:
    """Hides the messages of OpenCV and FFmpeg: gsut itself reports what is wrong, once."""
    import cv2

    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    before = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        cv2.utils.logging.setLogLevel(before)


def _is_without_index(path: Path) -> bool:
    """Returns whether an MP4 or MOV has no 'moov' box, which cameras write when recording ends."""
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
