"""Reads images and masks: sizes from headers, pixels as 8-bit RGB, and exact area down-scaling."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import NamedTuple

import numpy as np

from gsut.data.errors import DatasetError
from gsut.files import (
    ENDINGS,
    FileError,
    open_binary,
    open_image,
    read_picture_bytes,
    register_reader,
)
from gsut.orientation import EXIF_HEADER, read_orientation

IMAGE_SUFFIXES = ENDINGS["picture"]
# Formats whose headers Pillow reads; decoders turn the pixels of a TIFF upright.
_FORMATS = ("JPEG", "PNG", "WEBP", "BMP")
_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_JPEG_BARE = frozenset({0x01, *range(0xD0, 0xD9)})  # markers without a length
_JPEG_START = b"\xff\xd8"
# What the decoder says of data that no encoder writes, and of which it made the picture up.
_JPEG_EXTRA = "extraneous bytes"
_JPEG_DAMAGE = ("premature end", "bad Huffman code", _JPEG_EXTRA)
_JPEG_END = b"\xff\xd9"
_LEAST_PADDING = 4  # bytes: the data of a picture may end in a few zeros
_KEPT_PADDING = 64  # bytes that may be data of the picture: less than one row of blocks
_OPAQUE = 250  # least alpha that may be full: some encoders write 254 for 255 throughout
_COPY_AGAIN = "copy or export the file again"


class ImageHeader(NamedTuple):
    """Size of an image in pixels, and EXIF's orientation, 1 for upright."""

    width: int
    height: int
    orientation: int = 1


@register_reader("header of a picture", *IMAGE_SUFFIXES, fails=DatasetError)
def read_header(path: Path) -> ImageHeader:
    """Reads an image's size and orientation from its header.

    The size is that of the stored pixels: EXIF's orientation is returned, not applied.

    Raises:
        DatasetError: the file is not an image, or ends within the header.
    """
    try:
        with open_image(path, _FORMATS) as image:
            exif = image.info.get("exif", b"").removeprefix(EXIF_HEADER)
            width, height = image.size
            return ImageHeader(width, height, read_orientation(exif) if exif else 1)
    except FileError:
        pixels, _ = decode_image(path)  # says what is wrong, unless OpenCV can read it
        return ImageHeader(pixels.shape[1], pixels.shape[0])


def decode_image(path: Path, reduction: int = 1) -> tuple[np.ndarray, np.ndarray | None]:
    """Decodes an image without applying its EXIF orientation (poses belong to the stored pixels).

    Args:
        path: the file.
        reduction: 1, 2, 4 or 8: a JPEG is decoded at that part of its size, rounded up, in less
            time and memory; other files are decoded as they are.

    Returns:
        (H, W, 3) uint8 RGB, grey repeated, 16 bits rounded to 8; and (H, W) bool, True where
        alpha is full, or None without an alpha channel.
    Raises:
        DatasetError: not an image, or truncated (decoders fill the rest with grey in silence).
    """
    import cv2  # here and below, because gsut --help needs none

    pixels = _decode(path, reduction)
    if pixels.dtype == np.uint16:
        pixels = ((pixels.astype(np.uint32) + 128) // 257).astype(np.uint8)
    elif pixels.dtype != np.uint8:
        raise DatasetError(
            path, f"the pixels are {pixels.dtype}", "convert the image to 8 or 16 bits"
        )
    if pixels.ndim == 2:
        return cv2.cvtColor(pixels, cv2.COLOR_GRAY2RGB), None
    if pixels.shape[2] == 3:
        return cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB), None
    if pixels.shape[2] == 4:
        alpha = pixels[:, :, 3]
        return cv2.cvtColor(pixels, cv2.COLOR_BGRA2RGB), alpha == max(alpha.max(), _OPAQUE)
    raise DatasetError(
        path, f"{pixels.shape[2]} channels", "convert the image to grey, RGB or RGBA"
    )


def find_largest_value(path: Path) -> int | None:
    """Returns the largest value of an image file with 16 bits a channel; None if it has 8.

    Raises:
        DatasetError: see `decode_image`.
    """
    with open_binary(path, fails=DatasetError) as file:
        head = file.read(26)
    png = head.startswith(_PNG_SIGNATURE) and len(head) == 26
    if head.startswith(b"\xff\xd8") or (png and head[24] != 16):
        return None
    pixels = _decode(path)
    return int(pixels.max(initial=0)) if pixels.dtype == np.uint16 else None


def decode_scaled(
    path: Path, full: tuple[int, int], size: tuple[int, int], *, in_parts: bool
) -> tuple[np.ndarray, np.ndarray | None]:
    """Decodes an image and shrinks it by areas.

    Args:
        path: the file.
        full: width and height that the file must have.
        size: width and height wanted, not larger.
        in_parts: a JPEG may be decoded at a part of its size that is not smaller than `size`:
            faster, and other bits than by areas of the whole.

    Returns:
        See `decode_image`; the second is None where all is valid.

    Raises:
        DatasetError: cannot be decoded, or has another size.
    """
    least = max(1.0, min(full[0] / size[0], full[1] / size[1]))
    part = next(part for part in (8, 4, 2, 1) if part <= least) if in_parts else 1
    pixels, valid = decode_image(path, part)
    if pixels.shape[:2] not in [(-(-full[1] // by), -(-full[0] // by)) for by in (1, part)]:
        raise DatasetError(
            path,
            f"the image is {pixels.shape[1]} x {pixels.shape[0]}, expected {full[0]} x {full[1]}",
            "the file changed after the dataset was loaded: load it again",
        )
    if valid is not None:
        valid = None if valid.all() else shrink_mask(valid, *size)
    return shrink_image(pixels, *size), valid


def _decode(path: Path, reduction: int = 1) -> np.ndarray:
    import cv2

    data = read_picture_bytes(path, fails=DatasetError)
    _require_complete(data, path)
    pixels = _decode_jpeg(data, path, reduction) if data.startswith(_JPEG_START) else None
    if pixels is None:
        try:
            pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
        except cv2.error as error:
            if error.code == cv2.Error.StsNoMem:
                raise MemoryError(str(error)) from error
    if pixels is None:
        raise DatasetError(path, "cannot be decoded as an image", f"{_COPY_AGAIN} as PNG or JPEG")
    return pixels


def _decode_jpeg(data: bytes, path: Path, reduction: int) -> np.ndarray | None:
    """Decodes a JPEG to grey (H, W) or BGR (H, W, 3), OpenCV's bits; None: leave it to OpenCV.

    Raises:
        DatasetError: the decoder met data that no encoder writes, and made up the rest.
    """
    import simplejpeg

    try:
        height, width, kind, _ = simplejpeg.decode_jpeg_header(data)
        if kind not in ("Gray", "YCbCr", "RGB"):
            return None
        color = "GRAY" if kind == "Gray" else "BGR"
        least = {"min_height": -(-height // reduction), "min_width": -(-width // reduction)}
        pixels = simplejpeg.decode_jpeg(data, color, **least)
    except ValueError as error:
        extra = _JPEG_EXTRA in str(error) and _is_padded(data)
        if any(words in str(error) for words in _JPEG_DAMAGE) and not extra:
            raise DatasetError(path, f"the JPEG file is damaged: {error}", _COPY_AGAIN) from None
        return None  # OpenCV reads past it
    return pixels[:, :, 0] if color == "GRAY" else pixels


def _is_padded(data: bytes) -> bool:
    """Returns whether blanks fill the space between a JPEG's data and its end, as some cameras
    write them. Without them the picture is whole: else they stand in place of its data."""
    import simplejpeg

    end = data.find(_JPEG_END, _find_scan_start(data) or 0)
    last = len(data[:end].rstrip(b"\0\xff"))
    if end - last < _LEAST_PADDING:
        return False
    try:
        simplejpeg.decode_jpeg(data[: min(end, last + _KEPT_PADDING)] + _JPEG_END, min_height=1)
    except ValueError as error:
        return _JPEG_EXTRA in str(error)
    return True


def _require_complete(data: bytes, path: Path) -> None:
    """Requires all chunks of a PNG with right checksums, and the end marker of a JPEG."""
    if data.startswith(_PNG_SIGNATURE):
        position, kind = len(_PNG_SIGNATURE), b""
        while kind != b"IEND":
            if position + 12 > len(data):
                break
            length, kind = struct.unpack_from(">I4s", data, position)
            end = position + 12 + length
            if end > len(data):
                kind = b""
                break
            if (
                zlib.crc32(data[position + 4 : end - 4])
                != struct.unpack_from(">I", data, end - 4)[0]
            ):
                raise DatasetError(
                    path,
                    f"the PNG file is damaged: wrong checksum of a chunk at byte {position}",
                    _COPY_AGAIN,
                )
            position = end
        if kind != b"IEND":
            raise DatasetError(
                path, f"the PNG file is truncated: it ends after {len(data)} bytes", _COPY_AGAIN
            )
    elif data.startswith(_JPEG_START):
        # In the compressed data FF is always followed by 00 or a marker: FF D9 is the end.
        # Previews in the header have an end of their own, so search after the start of scan.
        scan = _find_scan_start(data)
        if scan is None or data.find(_JPEG_END, scan) < 0:
            raise DatasetError(
                path, f"the JPEG file is truncated: it ends after {len(data)} bytes", _COPY_AGAIN
            )


def _find_scan_start(data: bytes) -> int | None:
    position = 2
    while position + 4 <= len(data) and data[position] == 0xFF:
        marker = data[position + 1]
        if marker == 0xDA:
            return position
        if marker == 0xFF:
            position += 1
        elif marker in _JPEG_BARE:
            position += 2
        else:
            position += 2 + struct.unpack_from(">H", data, position + 2)[0]
    return None


@register_reader("mask", *IMAGE_SUFFIXES, fails=DatasetError)
def decode_mask(path: Path) -> np.ndarray:
    """Decodes a mask: (H, W) bool, True (valid) where the value is above half of white.

    White is the type's maximum; files with values 0 and 1 only are taken as 0 and white. With an
    alpha channel and no colour the first channel decides; where colours are alike throughout, as
    editors save a selection, alpha does.
    """
    pixels = _decode(path)
    if pixels.ndim == 3 and pixels.shape[2] == 4 and (pixels[..., :3] == pixels[0, 0, :3]).all():
        pixels = pixels[:, :, 3]
    if pixels.ndim == 3:
        pixels = pixels[:, :, :3].max(axis=2)
    white = np.iinfo(pixels.dtype).max if pixels.dtype.kind == "u" else 1.0
    if pixels.max(initial=0) <= 1:
        white = 1
    return pixels > white / 2


def shrink_image(pixels: np.ndarray, width: int, height: int) -> np.ndarray:
    """Shrinks (H, W, 3) uint8 to (height, width, 3): each pixel is the mean over its area."""
    if pixels.shape[:2] == (height, width):
        return pixels
    import cv2

    return cv2.resize(pixels, (width, height), interpolation=cv2.INTER_AREA)


def shrink_mask(valid: np.ndarray, width: int, height: int) -> np.ndarray:
    """Shrinks (H, W) bool to (height, width): valid if every source pixel that it touches is."""
    if valid.shape == (height, width):
        return valid
    if valid.all():
        return np.ones((height, width), bool)
    import cv2

    invalid = cv2.integral((~valid).view(np.uint8))  # int32, one row and column of 0 in front
    top, bottom = _find_source_range(valid.shape[0], height)
    left, right = _find_source_range(valid.shape[1], width)
    count = invalid[bottom][:, right] - invalid[top][:, right]
    count += invalid[top][:, left] - invalid[bottom][:, left]
    return count == 0


def shrink_both(
    pixels: np.ndarray, valid: np.ndarray | None, width: int, height: int
) -> tuple[np.ndarray, np.ndarray | None]:
    """Shrinks an image, and its mask if there is one."""
    small = None if valid is None else shrink_mask(valid, width, height)
    return shrink_image(pixels, width, height), small


def _find_source_range(source: int, target: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns the first source pixel that each target pixel touches, and one past the last."""
    index = np.arange(target)
    return index * source // target, -(-(index + 1) * source // target)
