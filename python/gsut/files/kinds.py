"""What a file is: pictures and videos by their first bytes, else by the endings of their names."""

from __future__ import annotations

import os
import re
import stat
from pathlib import Path

# Endings of names, where first bytes say nothing: of damaged files and of those without a mark.
ENDINGS = {
    "picture": (".jpg", ".jpeg", ".jpe", ".jfif", ".png", ".webp", ".tif", ".tiff", ".bmp"),
    "heif": (".heic", ".heif", ".hif"),
    "raw": (".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".rw2", ".orf"),
    "video": (
        ".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm", ".mts", ".m2ts", ".360", ".insv", ".osv",
        ".lrv", ".mpg", ".mpeg", ".vob", ".3gp", ".3g2", ".wmv", ".asf", ".flv", ".ogv",
    ),
}  # fmt: skip
# First bytes of each kind, and where they stand. A TIFF may be a raw photograph.
_STARTS = (
    ("picture", 0, b"\xff\xd8\xff"), ("picture", 0, b"\x89PNG\r\n\x1a\n"), ("picture", 8, b"WEBP"),
    ("tiff", 0, b"II*\0"), ("tiff", 0, b"MM\0*"),
    ("raw", 0, b"FUJIFILM"), ("raw", 0, b"IIU\0"), ("raw", 0, b"IIRO"), ("raw", 0, b"IIRS"),
    ("video", 0, b"\x1aE\xdf\xa3"), ("video", 8, b"AVI "), ("video", 0, b"0&\xb2u\x8ef\xcf\x11"),
    ("video", 0, b"\0\0\1\xba"), ("video", 0, b"\0\0\1\xb3"), ("video", 0, b"FLV\1"),
    ("video", 4, b"moov"), ("video", 4, b"mdat"), ("video", 4, b"wide"),
)  # fmt: skip
# Brands of ISO files that are no films, at byte 8.
_BRANDS = {b"crx ": "raw"} | dict.fromkeys(
    (b"heic", b"heix", b"heim", b"heis", b"mif1", b"msf1", b"avif"), "heif"
)
_PACKETS = ((0, 188), (4, 192))  # first byte and length of a transport stream's packets
_SYNC = 0x47  # first byte of a packet
_LOOKED_AT = 512  # bytes


def find_kind(path: str | os.PathLike[str]) -> str:
    """Returns "picture", "heif", "raw" or "video"; "" for any other file.

    First bytes decide over the name: a HEIC called .jpg is none. Formats that they do not name
    have the kind of their ending.
    """
    ending = Path(path).suffix.lower()
    by_name = next((kind for kind, endings in ENDINGS.items() if ending in endings), "")
    try:
        if not stat.S_ISREG(os.stat(path).st_mode):
            return "" if os.path.isdir(path) else by_name
        with open(path, "rb") as file:
            found = _find_kind_of_bytes(file.read(_LOOKED_AT))
    except (OSError, ValueError):
        return by_name
    if found == "tiff":
        return by_name if by_name == "raw" else "picture"
    return found or by_name


def _find_kind_of_bytes(data: bytes) -> str:
    if data[4:8] == b"ftyp":
        return _BRANDS.get(data[8:12], "video")
    for first, length in _PACKETS:
        places = data[first::length]
        if len(places) > 1 and set(places) == {_SYNC}:
            return "video"
    return next((kind for kind, at, mark in _STARTS if data[at:].startswith(mark)), "")


def split_numbers(name: str) -> tuple[object, ...]:
    """Returns a key that sorts names as people count: 2 before 10."""
    parts = re.split(r"([0-9]+)", name)
    numbers = ((len(part.lstrip("0")), part.lstrip("0")) for part in parts[1::2])
    return (*(x for pair in zip(parts[::2], [*numbers, ()], strict=True) for x in pair), name)
