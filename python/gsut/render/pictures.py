"""Writes pictures and videos, as a whole or not at all, with a clear sentence where that fails."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from gsut._core import InputError
from gsut.files import whole_file, write_file

_CODEC = "mp4v"  # MPEG-4 part 2: the one .mp4 codec that every build of OpenCV's wheels can write


def to_uint8(image: np.ndarray) -> np.ndarray:
    """Colours as bytes, ready to be written.

    Args:
        image: floating point, in [0, 1]; values outside are clipped, NaN becomes 0.

    Returns:
        uint8 of the same shape, rounded.
    """
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
    write_file(path, data.tobytes())


def write_video(path: Path, frames: Iterable[np.ndarray], frames_per_second: float) -> int:
    """Writes an .mp4 video.

    Args:
        path: the file; must not exist.
        frames: (H, W, 3) uint8 red, green, blue, all of one size; at least one. Odd sizes lose
            their last row or column, which the codec cannot hold.
        frames_per_second: of the video.

    Returns:
        The number of frames written.

    Raises:
        InputError: OpenCV cannot write such a video here, or the file cannot be written.
    """
    import cv2

    count = 0
    writer = None
    with whole_file(path) as temporary:
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
