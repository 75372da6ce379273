"""SuperSplat's compressed PLY: 16 bytes a Gaussian and a byte a harmonic, in chunks of 256."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.files import create_file, open_binary, register_reader
from gsut.formats._format import Format, SceneFile, WriteSettings, Written, check_claim
from gsut.formats._origin import format_origin, parse_origin
from gsut.formats._quantize import (
    drop_largest,
    logits_from_opacity,
    opacity_from_logits,
    restore_largest,
    to_bytes,
)
from gsut.formats.ply import PACKED, format_antialiased, is_antialiased
from gsut.gaussians import SH_C0, Gaussians, order_by_morton_code

_CHUNK = 256  # Gaussians with bounds of their own
_BOUNDS = [
    f"{end}_{name}"
    for group in (("x", "y", "z"), ("scale_x", "scale_y", "scale_z"), ("r", "g", "b"))
    for end in ("min", "max")
    for name in group
]
_PACKED = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
_THREE_BITS = (11, 10, 11)  # of x, y, z in one number
_MOST_LOG_SCALE = 20.0  # either way, that readers of the format accept
_SH_RANGE = 8.0  # a byte spans -4 to 4


def _write(path: Path, gaussians: Gaussians, settings: WriteSettings) -> Written:
    """Writes Gaussians in Morton order, so that those of a chunk lie close together."""
    order = order_by_morton_code(gaussians.means)
    g = gaussians[order]
    log_scales = np.clip(g.log_scales, -_MOST_LOG_SCALE, _MOST_LOG_SCALE)
    position_bounds, position = _scale_chunks(g.means)
    scale_bounds, scale = _scale_chunks(log_scales)
    color_bounds, color = _scale_chunks(0.5 + SH_C0 * g.sh[:, 0])
    rgba = np.concatenate([color, opacity_from_logits(g.opacity_logits)[:, None]], axis=1)
    vertices = np.empty((len(g), 4), "<u4")
    vertices[:, 0] = _pack(position, _THREE_BITS)
    vertices[:, 1] = _pack_rotations(g.quats)
    vertices[:, 2] = _pack(scale, _THREE_BITS)
    vertices[:, 3] = _pack(rgba, (8, 8, 8, 8))
    rest = g.sh[:, 1:].transpose(0, 2, 1).reshape(len(g), -1)  # channel-major
    sh, clipped = to_bytes((rest / _SH_RANGE + 0.5) * 256 - 0.5)
    chunks = np.concatenate([position_bounds, scale_bounds, color_bounds], axis=1).astype("<f4")
    with create_file(path) as file:
        comments = [format_antialiased(settings.antialiased), *format_origin(gaussians)]
        file.write(_build_header(len(g), rest.shape[1], comments))
        for array in (chunks, vertices, sh):
            file.write(array.tobytes())
    counts = {
        "scale": int(np.count_nonzero(log_scales != g.log_scales)),
        "harmonics": clipped,
    }
    return Written(order, counts)


def _build_header(count: int, harmonics: int, comments: list[str]) -> bytes:
    lines = ["ply", "format binary_little_endian 1.0"]
    lines += [f"comment {comment}" for comment in ("written by gsut", *comments)]
    lines += [f"element chunk {-(-count // _CHUNK)}"]
    lines += [f"property float {name}" for name in _BOUNDS]
    lines += [f"element vertex {count}", *(f"property uint {name}" for name in _PACKED)]
    if harmonics:
        lines += [f"element sh {count}"]
        lines += [f"property uchar f_rest_{i}" for i in range(harmonics)]
    return ("\n".join([*lines, "end_header"]) + "\n").encode()


def _scale_chunks(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the least and most (C, 6) of each chunk, and values (N, 3) between them, 0 to 1."""
    starts = np.arange(0, len(values), _CHUNK)
    values = values.astype(np.float32)
    low, high = np.minimum.reduceat(values, starts), np.maximum.reduceat(values, starts)
    chunk = np.arange(len(values)) // _CHUNK
    width = np.maximum(high.astype(np.float64) - low, 1e-30)
    return np.concatenate([low, high], axis=1), (values - low[chunk]) / width[chunk]


def _pack(values: np.ndarray, bits: tuple[int, ...]) -> np.ndarray:
    """Packs values in [0, 1] into one number a row, the first in the highest bits."""
    packed = np.zeros(len(values), np.uint32)
    for column, width in zip(values.T, bits, strict=True):
        packed = (packed << np.uint32(width)) | np.rint(column * (2**width - 1)).astype(np.uint32)
    return packed


def _unpack(packed: np.ndarray, bits: tuple[int, ...]) -> np.ndarray:
    columns, shift = [], 32
    for width in bits:
        shift -= width
        columns.append(((packed >> np.uint32(shift)) & np.uint32(2**width - 1)) / (2**width - 1))
    return np.stack(columns, axis=1)


def _pack_rotations(quats: np.ndarray) -> np.ndarray:
    largest, others = drop_largest(quats)
    values = np.concatenate([largest[:, None] / 3, 0.5 + 0.5 * others], axis=1)
    return _pack(values, (2, 10, 10, 10))


@register_reader("compressed PLY", ".ply")
def _read(path: Path) -> SceneFile:
    elements, comments, begin = _parse_header(path)
    count, chunks = elements["vertex"][0], elements["chunk"][0]
    harmonics = len(elements["sh"][1]) if "sh" in elements else 0
    check_claim(path, count, path.stat().st_size)
    if chunks != -(-count // _CHUNK):
        raise InputError(
            f"{path}: damaged: the header announces {count:,} Gaussians in {chunks:,} chunks, "
            f"which have {_CHUNK} each"
        )
    sizes = [4 * len(_BOUNDS) * chunks, 16 * count, harmonics * count]
    with open_binary(path) as file:
        file.seek(begin)
        data = np.frombuffer(file.read(sum(sizes)), np.uint8)
    bounds, packed, sh = np.split(data, np.cumsum(sizes[:2]))
    limits = bounds.view("<f4").reshape(-1, len(_BOUNDS))
    for name, low, high in _pair_bounds(limits):
        if not (np.isfinite(low) & np.isfinite(high) & (low <= high)).all():
            raise InputError(
                f"{path}: damaged: a chunk's max_{name} is below its min_{name}, or one of them "
                "is not finite"
            )
    words = packed.view("<u4").reshape(-1, 4)
    chunk = np.arange(count) // _CHUNK

    def interpolate(first: int, values: np.ndarray) -> np.ndarray:
        low = limits[:, first : first + 3].astype(np.float64)
        return low[chunk] + values * (limits[:, first + 3 : first + 6] - low)[chunk]

    rotation = _unpack(words[:, 1], (2, 10, 10, 10))
    rgba = _unpack(words[:, 3], (8, 8, 8, 8))
    means = interpolate(0, _unpack(words[:, 0], _THREE_BITS))
    constant = (interpolate(12, rgba[:, :3]) - 0.5) / SH_C0
    rest = ((sh.reshape(count, 3, harmonics // 3) + 0.5) / 256 - 0.5) * _SH_RANGE
    return SceneFile(
        Gaussians(
            means.astype(np.float32),
            restore_largest(np.rint(3 * rotation[:, 0]).astype(int), 2 * rotation[:, 1:] - 1),
            interpolate(6, _unpack(words[:, 2], _THREE_BITS)),
            logits_from_opacity(rgba[:, 3]),
            np.concatenate([constant[:, None], rest.transpose(0, 2, 1)], axis=1),
        ).translate(parse_origin(comments, path)),
        is_antialiased(path),
    )


def _pair_bounds(limits: np.ndarray) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Yields each quantity's name with its least and its most (C,) in every chunk."""
    columns = dict(zip(_BOUNDS, limits.T, strict=True))
    for bound, low in columns.items():
        if bound.startswith("min_"):
            name = bound.removeprefix("min_")
            yield name, low, columns[f"max_{name}"]


def _parse_header(path: Path) -> tuple[dict[str, tuple[int, list[str]]], list[str], int]:
    """Reads each element's count and properties "TYPE NAME", the comments, and where data begin."""
    order, described, comments, begin = _core.read_ply_header(os.fsencode(path))
    elements = {
        name: (count, [f"{kind}{length} {each}" for each, kind, length in properties])
        for name, count, properties in described
    }
    harmonics = [f"u1 f_rest_{i}" for i in range(len(elements.get("sh", (0, []))[1]))]
    wanted = {
        "chunk": [f"f4 {name}" for name in _BOUNDS],
        "vertex": [f"u4 {name}" for name in _PACKED],
        **({"sh": harmonics} if "sh" in elements else {}),
    }
    layout = {name: properties for name, (_, properties) in elements.items()}
    if order != "<" or list(layout.items()) != [*wanted.items()]:
        raise InputError(
            f"{path}: no compressed PLY file of SuperSplat's present layout (elements chunk with "
            "18 bounds, vertex with 4 packed numbers, and sh)"
        )
    counts = {elements[name][0] for name in ("vertex", "sh") if name in elements}
    if len(counts) != 1 or len(harmonics) not in (0, 9, 24, 45):
        raise InputError(
            f"{path}: the element sh has {len(harmonics)} properties and the elements these "
            f"counts: {sorted(counts)}; 9, 24 or 45 and one count are needed"
        )
    return elements, comments, begin


FORMAT = Format(
    "compressed PLY",
    (".compressed.ply", ".ply"),
    _write,
    _read,
    lambda head: head.startswith(b"ply") and PACKED in head,
    keeps_origin=True,
)
