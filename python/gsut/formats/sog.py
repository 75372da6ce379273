"""SOG files, version 2: lossless WebP images of codebook entries in a zip archive."""

from __future__ import annotations

import io
import json
import math
import os
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.files import open_archive, parse_json, reading, register_reader, write_archive
from gsut.formats._fields import Fields
from gsut.formats._format import (
    Format,
    SceneFile,
    WriteSettings,
    Written,
    check_claim,
)
from gsut.formats._quantize import (
    build_codebook,
    drop_largest,
    find_nearest_entries,
    logits_from_opacity,
    opacity_from_logits,
    restore_largest,
)
from gsut.gaussians import Gaussians, order_by_morton_code

META = "meta.json"
_MOST_META = 1 << 20  # bytes; real ones have 16 thousand
_LOSSLESS = [cv2.IMWRITE_WEBP_QUALITY, 101]  # what OpenCV takes for: lossless
_MOST_SIDE = 16383  # pixels of a WebP image
_MOST_LOG = 88.0  # of a position: beyond it exp is no float32
_LARGEST_BEGIN = 252  # of a rotation's alpha: plus the place of its largest component
_PALETTE_COLUMNS = 64  # entries in a row of the image of a palette
_MOST_ENTRIES = 65536  # that a label of 16 bits can name
# Gaussians that share an entry of the palette of harmonics, on the average.
_SHARING = 4


def _write(path: Path, gaussians: Gaussians, settings: WriteSettings) -> Written:
    seen = find_visible(gaussians)
    if not len(seen):
        raise InputError(f"{path}: all Gaussians are of opacity 0; there is nothing to write")
    order = seen[order_by_morton_code(gaussians.means[seen])]
    write_archive(path, encode_members(path, gaussians[order], settings.antialiased).items())
    unseen = len(gaussians) - len(seen)
    said = f"{unseen:,} Gaussians of opacity below 1/510, which nobody sees, were left out"
    return Written(order, {}, (said,) if unseen else ())


def find_visible(gaussians: Gaussians) -> np.ndarray:
    """Finds the rows whose opacity is not stored as 0: WebP keeps no colour where alpha is 0."""
    return np.flatnonzero(np.rint(255 * opacity_from_logits(gaussians.opacity_logits)) > 0)


def encode_members(path: Path, g: Gaussians, antialiased: bool) -> dict[str, bytes]:
    """Encodes visible Gaussians, in their order, as the files of a SOG by name.

    Args:
        path: for messages.
        g: at least one, all visible.
        antialiased: see `WriteSettings`.
    """
    images, meta = _encode_images(g)
    if antialiased:
        meta |= {"antialias": True, "model": "antialiased"}
    members = {name: _encode_webp(path, pixels) for name, pixels in images.items()}
    members[META] = json.dumps(meta, separators=(",", ":")).encode()
    return members


def _encode_images(g: Gaussians) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Encodes Gaussians as images (H, W, 3 or 4) uint8 by name, and their description."""
    logs = np.sign(g.means) * np.log1p(np.abs(g.means.astype(np.float64)))
    low, high = logs.min(axis=0), logs.max(axis=0)
    steps = np.rint((logs - low) / np.maximum(high - low, 1e-300) * 65535).astype(np.uint16)
    largest, others = drop_largest(g.quats)
    rotation = np.rint(127.5 + 127.5 * others).astype(np.uint8)
    alpha = np.rint(255 * opacity_from_logits(g.opacity_logits)).astype(np.uint8)[:, None]
    scales, colors = build_codebook(g.log_scales), build_codebook(g.sh[:, 0])
    color = np.concatenate([find_nearest_entries(g.sh[:, 0], colors), alpha], axis=1)
    kind = (_LARGEST_BEGIN + largest[:, None]).astype(np.uint8)
    images = {
        "means_l.webp": _fill_image(steps.astype(np.uint8)),
        "means_u.webp": _fill_image((steps >> 8).astype(np.uint8)),
        "quats.webp": _fill_image(np.concatenate([rotation, kind], axis=1)),
        "scales.webp": _fill_image(find_nearest_entries(g.log_scales, scales)),
        "sh0.webp": _fill_image(color),
    }
    meta = {
        "version": 2,
        "asset": {"generator": "gsut"},
        "count": len(g),
        "antialias": False,
        "means": {
            "mins": low.tolist(),
            "maxs": high.tolist(),
            "files": ["means_l.webp", "means_u.webp"],
        },
        "scales": {"codebook": scales.tolist(), "files": ["scales.webp"]},
        "quats": {"files": ["quats.webp"]},
        "sh0": {"codebook": colors.tolist(), "files": ["sh0.webp"]},
    }
    if g.sh_degree:
        centroids, labels, meta["shN"] = _build_palette(g)
        images |= {"shN_centroids.webp": centroids, "shN_labels.webp": labels}
    return images, meta


def _build_palette(g: Gaussians) -> tuple[np.ndarray, np.ndarray, dict[str, Any]]:
    """Builds images of entries and labels of the harmonics above the constant one."""
    coefficients = g.sh.shape[1] - 1
    rows = np.ascontiguousarray(g.sh[:, 1:].reshape(len(g), -1), np.float32)
    wanted = min(_MOST_ENTRIES, max(1024, len(g) // _SHARING))
    entries, labels = _core.make_palette(rows, wanted)
    book = build_codebook(entries)
    lines = -(-len(entries) // _PALETTE_COLUMNS)
    pixels = np.zeros((lines * _PALETTE_COLUMNS, coefficients, 3), np.uint8)
    pixels[: len(entries)] = find_nearest_entries(entries, book).reshape(-1, coefficients, 3)
    two = np.stack([labels & 255, labels >> 8, np.zeros_like(labels)], axis=1).astype(np.uint8)
    described = {
        "count": len(entries),
        "bands": g.sh_degree,
        "codebook": book.tolist(),
        "files": ["shN_centroids.webp", "shN_labels.webp"],
    }
    return pixels.reshape(lines, _PALETTE_COLUMNS * coefficients, 3), _fill_image(two), described


def _fill_image(rows: np.ndarray) -> np.ndarray:
    """Fills an image with one pixel a Gaussian, as square as sides of multiples of four allow."""
    width = 4 * math.ceil(math.sqrt(len(rows)) / 4)
    height = 4 * math.ceil(len(rows) / width / 4)
    pixels = np.zeros((height * width, rows.shape[1]), np.uint8)
    pixels[: len(rows)] = rows
    return pixels.reshape(height, width, -1)


def _encode_webp(path: Path, pixels: np.ndarray) -> bytes:
    if max(pixels.shape) > _MOST_SIDE:
        raise InputError(
            f"{path}: an image of {pixels.shape[1]} x {pixels.shape[0]} pixels is needed, and WebP "
            f"has {_MOST_SIDE} at most; write fewer Gaussians"
        )
    swap = cv2.COLOR_RGBA2BGRA if pixels.shape[2] == 4 else cv2.COLOR_RGB2BGR
    return cv2.imencode(".webp", cv2.cvtColor(pixels, swap), _LOSSLESS)[1].tobytes()


@register_reader("SOG", ".sog")
def _read(path: Path) -> SceneFile:
    with open_archive(path) as archive, reading(path):
        if META not in archive.names:
            raise InputError(f"{path}: no SOG file: {META} is missing")
        return decode_members(path, archive, os.path.getsize(path))


def decode_members(path: Path, archive: Any, size: int) -> SceneFile:
    """Decodes the files of a SOG.

    Args:
        path: for messages.
        archive: `read(name, most_bytes)` returns the bytes of a file.
        size: bytes of all of them.
    """
    text = archive.read(META, _MOST_META)
    meta = Fields(path, parse_json(text, f"{path}, {META}", {}))
    if (version := meta.values.get("version")) != 2:
        raise InputError(f"{path}: SOG version {version}; gsut reads 2")
    count = meta.read_whole("count", 1)
    check_claim(path, count, size)
    gaussians = _decode_gaussians(_Images(path, archive), meta, count)
    antialiased = meta.values.get("antialias") is True
    antialiased |= meta.values.get("model") == "antialiased"
    return SceneFile(gaussians, antialiased)


class _Images:
    """The images of an archive; none is decoded that is not of the size it has to be."""

    def __init__(self, path: Path, archive: Any) -> None:
        self.path, self.archive = path, archive

    def read_pixels(
        self, name: str, count: int, channels: int, width: int | None = None
    ) -> np.ndarray:
        """Reads the first pixels (count, channels), row by row.

        Args:
            name: of the file.
            count: pixels wanted.
            channels: 3 or 4.
            width: that the image must have; None: any.
        """
        # A lossless pixel takes 4 bytes and the tables of an image some thousands, at most.
        data = self.archive.read(name, 5 * count + (1 << 16))
        found = _read_webp_size(data)
        if found is None:
            raise InputError(f"{self.path}: {name} is no lossless WebP image")
        wide, high = found
        spare = wide * (_PALETTE_COLUMNS if width is None else 1)
        if not count <= wide * high <= count + spare or wide != (width or wide):
            raise InputError(
                f"{self.path}: {name} has {wide} x {high} pixels, and {count:,} are needed"
            )
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
        if pixels is None or pixels.shape[:2] != (high, wide) or pixels.shape[2] < channels:
            raise InputError(f"{self.path}: {name} is damaged")
        order = [2, 1, 0, 3][:channels]
        return pixels.reshape(wide * high, -1)[:count, order]


def _read_webp_size(data: bytes) -> tuple[int, int] | None:
    """Reads width and height from a lossless WebP header; None if it is none."""
    bits = io.BytesIO(data)
    if bits.read(4) != b"RIFF" or bits.read(8)[4:] != b"WEBP":
        return None
    kind, length = bits.read(4), int.from_bytes(bits.read(4), "little")
    if kind == b"VP8X":  # an envelope with a size of its own; the image follows
        bits.seek(length, io.SEEK_CUR)
        kind = bits.read(4)
        bits.read(4)
    head = bits.read(5)
    if kind != b"VP8L" or len(head) < 5 or head[0] != 0x2F:
        return None
    sides = int.from_bytes(head[1:], "little")
    return (sides & 0x3FFF) + 1, (sides >> 14 & 0x3FFF) + 1


def _decode_gaussians(images: _Images, meta: Fields, count: int) -> Gaussians:
    means, quats, scales = (meta.read_fields(name) for name in ("means", "quats", "scales"))
    fine, coarse = (images.read_pixels(name, count, 3) for name in means.read_names("files", 2))
    low, high = (means.read_numbers(end, 3, 3) for end in ("mins", "maxs"))
    if (low > high).any() or max(np.abs(low).max(), np.abs(high).max()) > _MOST_LOG:
        raise InputError(
            f"{images.path}: damaged: means.mins is {low.tolist()} and means.maxs {high.tolist()}; "
            f"they have to rise, and to be logarithms within {_MOST_LOG:g}"
        )
    logs = low + (coarse * 256.0 + fine) / 65535 * (high - low)
    rotation = images.read_pixels(quats.read_names("files", 1)[0], count, 4)
    largest = rotation[:, 3].astype(int) - _LARGEST_BEGIN
    if largest.min() < 0:
        raise InputError(
            f"{images.path}: damaged: quats has an alpha of {rotation[:, 3].min()}; each has to be "
            f"{_LARGEST_BEGIN} to 255, which names the largest component"
        )
    sizes = images.read_pixels(scales.read_names("files", 1)[0], count, 3)
    base = meta.read_fields("sh0")
    color = images.read_pixels(base.read_names("files", 1)[0], count, 4)
    sh = _look_up(base, color[:, :3])[:, None]
    if meta.values.get("shN") is not None:
        sh = np.concatenate([sh, _decode_harmonics(images, meta.read_fields("shN"), count)], axis=1)
    return Gaussians(
        (np.sign(logs) * np.expm1(np.abs(logs))).astype(np.float32),
        restore_largest(largest, rotation[:, :3] / 127.5 - 1),
        _look_up(scales, sizes),
        logits_from_opacity(color[:, 3] / 255),
        sh,
    )


def _look_up(described: Fields, entries: np.ndarray) -> np.ndarray:
    """Returns the values of a codebook at these entries."""
    book = described.read_numbers("codebook", 1, 256).astype(np.float32)
    if entries.max() >= len(book):
        raise InputError(
            f"{described.path}: damaged: {described.name}.codebook has {len(book)} values, and an "
            f"image names value {entries.max()} (they count from 0)"
        )
    return book[entries]


def _decode_harmonics(images: _Images, described: Fields, count: int) -> np.ndarray:
    coefficients = (described.read_whole("bands", 1, 3) + 1) ** 2 - 1
    size = described.read_whole("count", 1, _MOST_ENTRIES)
    files = described.read_names("files", 2)
    lines = -(-size // _PALETTE_COLUMNS)
    width = _PALETTE_COLUMNS * coefficients
    entries = images.read_pixels(files[0], lines * width, 3, width)
    labels = images.read_pixels(files[1], count, 3).astype(np.int64)
    numbers = labels[:, 0] + 256 * labels[:, 1]
    if numbers.max() >= size:
        raise InputError(
            f"{images.path}: damaged: a label names entry {numbers.max():,} of the palette, and "
            f"shN.count is {size:,} (they count from 0)"
        )
    return _look_up(described, entries.reshape(-1, coefficients, 3)[:size])[numbers]


FORMAT = Format("SOG", (".sog",), _write, _read, lambda head: head.startswith(b"PK"))
