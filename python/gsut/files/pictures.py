"""Reads and writes pictures by OpenCV and Pillow, which get bytes and no names of files."""

from __future__ import annotations

import contextlib
import os
import struct
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from gsut.files.errors import Fails, FileError, reading
from gsut.files.opening import PathLike, open_binary, read_bytes
from gsut.files.writing import write_file
from gsut.orientation import add_orientation

# OpenCV reads no .exr otherwise, and looks once, at the first picture.
os.environ.setdefault("OPENCV_IO_ENABLE_OPENEXR", "1")

_PNG = b"\x89PNG\r\n\x1a\n"
_PNG_SIZE = 16  # place of width, height, bits and kind of colour in a PNG
_PNG_HEAD = 26  # bytes up to there
_PNG_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}  # of each kind of colour
_DEFLATES = 1040  # bytes that one of zlib can stand for, at most (1032)
_COPY_AGAIN = "copy or export the file again"


def write_picture(
    path: str | os.PathLike[str], pixels: Any, quality: int | None = None, turns: int = 0
) -> None:
    """Writes a picture in the format of its name, see `whole_file`.

    Args:
        path: the file.
        pixels: (H, W, 3) uint8 blue, green, red, or (H, W) uint8 or uint16, as OpenCV takes them.
        quality: of JPEG, up to 100.
        turns: quarter turns clockwise that show it upright, see `add_orientation`.
    """
    import cv2  # whose own writer of files does not say why it fails, and leaves what it began

    flags = [] if quality is None else [cv2.IMWRITE_JPEG_QUALITY, quality]
    _, data = cv2.imencode(Path(path).suffix, pixels, flags)
    write_file(path, add_orientation(data.tobytes(), turns))


def read_picture(path: PathLike, flags: int) -> Any:
    """Reads a picture of any name by OpenCV's `flags`; None if it is none.

    Raises:
        FileError: it cannot be opened, or claims more pixels than its bytes can hold.
    """
    import cv2  # whose own reader of files crashes at a str that is no UTF-8

    content = read_picture_bytes(path)
    try:
        return cv2.imdecode(np.frombuffer(content, np.uint8), flags)
    except cv2.error:
        return None


def read_picture_bytes(path: PathLike, *, fails: Fails = FileError) -> bytes:
    """Reads the bytes of a picture, which can hold the pixels that they claim.

    Raises:
        FileError: they cannot, or the file cannot be opened or is empty.
    """
    with reading(path, _COPY_AGAIN, fails):
        content = read_bytes(path)
        if not content:
            raise FileError(path, "the file is empty", _COPY_AGAIN)
        _check_claim(path, content[:_PNG_HEAD], len(content))
    return content


def _check_claim(path: PathLike, head: bytes, size: int) -> None:
    """Checks that a PNG of this many bytes can hold the pixels that its first bytes claim."""
    if not head.startswith(_PNG) or len(head) < _PNG_HEAD:
        return
    width, height, bits, kind = struct.unpack_from(">IIBB", head, _PNG_SIZE)
    if width * height * bits * _PNG_CHANNELS.get(kind, 1) // 8 > _DEFLATES * size:
        raise FileError(
            path, f"says {width} x {height} pixels, more than its {size} bytes can hold",
            _COPY_AGAIN,
        )  # fmt: skip


@contextlib.contextmanager
def open_image(path: PathLike, formats: tuple[str, ...] | None = None) -> Iterator[Any]:
    """Opens a picture by Pillow, which reads its header; every failure in the block names it.

    Args:
        path: the file.
        formats: names of Pillow's formats that are tried; None: all.
    """
    from PIL import Image, WebPImagePlugin  # noqa: F401  # here: gsut --help needs none

    Image.MAX_IMAGE_PIXELS = None  # panoramas are no bombs
    with open_binary(path) as file, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Pillow's, on damaged metadata
        size = os.fstat(file.fileno()).st_size
        _check_claim(path, file.read(_PNG_HEAD), size)
        file.seek(0)
        with Image.open(file, formats=formats) as image:
            yield image
