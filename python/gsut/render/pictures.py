"""Writes pictures and videos, as a whole or not at all, with a clear sentence where that fails."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from gsut._core import InputError

_CODEC = "mp4v"  # MPEG-4 part 2: the one .mp4 codec that every build of OpenCV's wheels can write


def to_uint8(image: np.ndarray) -> np.ndarray:
    """Colours in [0, 1] as uint8, rounded; values outside are clipped, NaN becomes 0."""
    return np.rint(np.clip(np.nan_to_num(image), 0.0, 1.0) * 255.0).astype(np.uint8)


def write_png(path: Path, image: np.ndarray) -> None:
    """Writes a picture as PNG.

    Args:
        path: the file; replaced where it exists.
        image: (H, W, 3) uint8 red, green, blue; or (H, W) uint8 or uint16.

    Raises:
        InputError: the file cannot be written.
    """
    import cv2

    pixels = image[..., ::-1] if image.ndim == 3 else image
    _, data = cv2.imencode(".png", np.ascontiguousarray(pixels))
    try:
        with _unfinished(path) as temporary:
            temporary.write_bytes(data.tobytes())
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror or error}") from None


def write_video(path: Path, frames: Iterable[np.ndarray], frames_per_second: float) -> int:
    """Writes an .mp4 video; returns the number of frames.

    Args:
        path: the file; must not exist.
        frames: (H, W, 3) uint8 red, green, blue, all of one size; at least one. Odd sizes lose
            their last row or column, which the codec cannot hold.
        frames_per_second: frames a second.

    Raises:
        InputError: OpenCV cannot write such a video here, or the file cannot be written.
    """
    import cv2

    count = 0
    writer = None
    try:
        with _unfinished(path) as temporary:
            try:
                for frame in frames:
                    height, width = (size - size % 2 for size in frame.shape[:2])
                    if writer is None:
                        codec = cv2.VideoWriter.fourcc(*_CODEC)
                        writer = cv2.VideoWriter(
                            str(temporary), codec, frames_per_second, (width, height)
                        )
                        if not writer.isOpened():
                            raise InputError(
                                f"OpenCV cannot write the video {path} ({width} x {height}) here; "
                                "give a folder instead to get the frames as images"
                            )
                    writer.write(np.ascontiguousarray(frame[:height, :width, ::-1]))
                    count += 1
            finally:
                if writer is not None:
                    writer.release()
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror or error}") from None
    return count


def picture_stems(names: Sequence[str]) -> list[str]:
    """File names without extension for views: folders become _, and no two are the same."""
    stems: list[str] = []
    taken: set[str] = set()
    for name in names:
        stem = Path(name).with_suffix("").as_posix().strip("/.").replace("/", "_") or "view"
        unique, number = stem, 2
        while unique in taken:
            unique, number = f"{stem}-{number}", number + 1
        taken.add(unique)
        stems.append(unique)
    return stems


@contextlib.contextmanager
def _unfinished(path: Path):
    """A temporary path beside `path` (same extension), renamed to it if the block succeeds."""
    temporary = path.with_name(f".writing-{os.getpid()}-{path.name}")
    try:
        yield temporary
        os.replace(temporary, path)
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink()
