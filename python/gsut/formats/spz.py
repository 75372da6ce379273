"""SPZ files, versions 2 to 4: fixed-point numbers in planes, compressed by gzip or zstd."""

from __future__ import annotations

import dataclasses
import itertools
import math
import struct
import warnings
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.files import read_bytes, register_reader, write_file
from gsut.formats._format import Format, SceneFile, WriteSettings, Written, check_claim
from gsut.formats._quantize import (
    drop_largest,
    logits_from_opacity,
    opacity_from_logits,
    restore_largest,
    to_bytes,
)
from gsut.gaussians import Gaussians, transform_gaussians

_MAGIC = 0x5053474E
_HEADER = struct.Struct("<IIIBBBB")
_HEADER_4 = struct.Struct("<IIIBBBBI12x")
_ENTRY = struct.Struct("<QQ")  # of version 4's table: bytes compressed and not
_GZIP = b"\x1f\x8b"
_ANTIALIASED = 1  # a bit of the flags
_EXTENDED = 2  # a bit of the flags: records of kind and size follow the Gaussians
_RECORD = struct.Struct("<II")  # kind and size in bytes of what follows
_ORBIT = 0xADBE0002  # a kind: how far a viewer should turn around the scene
_AXES = 0xADBE0003  # a kind: the axes of the Gaussians, as a number
# Axes by that number; unspecified ones are those of PLY files. From 9 on, writers disagree.
_AXES_NAMES = ("unspecified", "LDB", "RDB", "LUB", "RUB", "LDF", "RDF", "LUF", "RUF")
_AXES_READ = ("unspecified", "RDF")  # x right, y down, z forward: kept as they are
_AXES_TURNED = "RUB"  # x right, y up, z backward: half a turn about x away
_DOWN_FROM_UP = np.diag([1.0, -1.0, -1.0])  # that turn
_MOST_EXTENDED = 1 << 20  # bytes of such records
_LARGEST = 2**23 - 1  # of a position, in steps
_MOST_FRACTIONAL_BITS = 24
_ROUNDING = 1 / 16  # of positions, in sizes of the median Gaussian: below what a view shows
_MOST_FAR = 0.01  # share of the scene that may lie too far for this rounding
_LOG_SCALE_STEPS = 16.0  # byte = (log scale + 10) 16
_LOG_SCALE_ZERO = 10.0  # of the same formula
_COLOR_SCALE = 0.15  # byte = 255 (0.15 harmonic + 0.5)
# Harmonics lie on every second of the 256 steps from -1 to 1. Other writers keep 5 and 4 bits:
# files a third smaller, with an error that shows in a view.
_SH_STEP = 2
_ROTATION_STEPS = 511
_DEFLATE_MOST = 1032  # the most bytes that deflate makes of one


@dataclasses.dataclass(frozen=True)
class _Layout:
    """The content of a header."""

    version: int
    count: int
    degree: int
    fractional_bits: int
    flags: int

    def count_bytes(self) -> list[int]:
        """Counts the bytes of positions, opacities, colours, scales, rotations and harmonics."""
        harmonics = 3 * ((self.degree + 1) ** 2 - 1)
        rotation = 3 if self.version == 2 else 4
        return [self.count * each for each in (9, 1, 3, 3, rotation, harmonics)]


def _write(path: Path, gaussians: Gaussians, settings: WriteSettings) -> Written:
    clipped = {}
    g, bits, clipped["distance"] = _fit_coordinates(path, gaussians)
    steps = np.rint(g.means.astype(np.float64) * 2.0**bits).astype("<i4")
    positions = steps.reshape(-1, 1).view(np.uint8)[:, :3]
    alphas, _ = to_bytes(255 * opacity_from_logits(g.opacity_logits))
    colors, clipped["color"] = to_bytes(255 * (_COLOR_SCALE * g.sh[:, 0].astype(np.float64) + 0.5))
    scales, clipped["scale"] = to_bytes(_LOG_SCALE_STEPS * (g.log_scales + _LOG_SCALE_ZERO))
    rotations = _pack_rotations(g.quats)
    harmonics, clipped["harmonics"] = _pack_harmonics(g.sh[:, 1:])
    planes = [
        array.tobytes() for array in (positions, alphas, colors, scales, rotations, harmonics)
    ]
    flags = _ANTIALIASED if settings.antialiased else 0
    head = (_MAGIC, settings.spz_version, len(g), g.sh_degree, bits, flags)
    if settings.spz_version == 3:
        write_file(path, _compress_gzip(_HEADER.pack(*head, 0) + b"".join(planes)))
    elif settings.spz_version == 4:
        write_file(path, _build_streams(head, [plane for plane in planes if plane]))
    else:
        raise InputError(f"SPZ version {settings.spz_version} is not written; 3 and 4 are")
    return Written(None, clipped)


def _fit_coordinates(path: Path, g: Gaussians) -> tuple[Gaussians, int, int]:
    """Returns Gaussians that fit, their fractional bits, and how many were moved nearer for that.

    A few far ones, of a sky, would take the digits that all others need: they come nearer along
    their direction from the file's zero and get smaller alike.
    """
    far = np.max(np.abs(g.means), axis=1)
    bits = _count_fractional_bits(path, float(far.max(initial=0.0)))
    size = float(np.exp(np.median(g.log_scales)))
    wanted = min(_MOST_FRACTIONAL_BITS, math.ceil(-math.log2(2 * _ROUNDING * max(size, 1e-30))))
    most = (_LARGEST - 0.5) / 2.0**wanted
    beyond = far > most
    count = int(np.count_nonzero(beyond))
    if bits >= wanted or count > _MOST_FAR * len(g):
        return g, bits, 0
    nearer = np.where(beyond, most / np.maximum(far, most), 1.0).astype(np.float32)[:, None]
    g = dataclasses.replace(g, means=g.means * nearer, log_scales=g.log_scales + np.log(nearer))
    return g, wanted, count


def _count_fractional_bits(path: Path, extent: float) -> int:
    """Counts the fractional bits that leave room for the largest coordinate."""
    bits = _MOST_FRACTIONAL_BITS
    if extent > 0:
        bits = min(bits, math.floor(math.log2((_LARGEST - 0.5) / extent)))
    if bits < 0:
        raise InputError(
            f"{path}: coordinates up to {extent:.4g} do not fit into SPZ, which holds whole units "
            f"up to {_LARGEST:,} at the coarsest; recentre or scale the scene (gsut edit), or "
            "choose another format"
        )
    return bits


def _pack_rotations(quats: np.ndarray) -> np.ndarray:
    """Packs the three smallest of x, y, z, w, each as 10 bits of sign and size."""
    largest, others = drop_largest(quats[:, [1, 2, 3, 0]])
    packed = largest.astype("<u4")
    for column in others.T:
        size = np.rint(np.abs(column) * _ROTATION_STEPS).astype(np.uint32)
        packed = (packed << 10) | (np.where(column < 0, 512, 0).astype(np.uint32) | size)
    return packed.astype("<u4")


def _pack_harmonics(sh: np.ndarray) -> tuple[np.ndarray, int]:
    # The zero of a byte is 128; the last multiple of a step below 256 is the edge.
    wanted = np.rint(128 / _SH_STEP * sh) * _SH_STEP + 128
    most = 256 - _SH_STEP
    beyond = int(np.count_nonzero((wanted < 0) | (wanted > most)))
    return np.clip(wanted, 0, most).astype(np.uint8), beyond


def _compress_gzip(data: bytes) -> bytes:
    compressor = zlib.compressobj(6, zlib.DEFLATED, 16 + zlib.MAX_WBITS)
    return compressor.compress(data) + compressor.flush()


def _import_zstandard() -> Any:
    try:
        import zstandard
    except ImportError:
        raise InputError(
            "SPZ version 4 is compressed by zstd, which Python lacks here: pip install zstandard "
            "(or write version 3, which needs nothing)"
        ) from None
    return zstandard


def _build_streams(head: tuple[int, ...], planes: list[bytes]) -> bytes:
    compressor = _import_zstandard().ZstdCompressor(level=12)
    packed = [compressor.compress(plane) for plane in planes]
    table = [
        _ENTRY.pack(len(small), len(plane)) for small, plane in zip(packed, planes, strict=True)
    ]
    return b"".join([_HEADER_4.pack(*head, len(planes), _HEADER_4.size), *table, *packed])


@register_reader("SPZ", ".spz")
def _read(path: Path) -> SceneFile:
    data = read_bytes(path)
    layout, planes, records = (
        _decompress_gzip(path, data) if data[:2] == _GZIP else _decompress_zstandard(path, data)
    )
    bytes_of = [np.frombuffer(plane, np.uint8) for plane in planes]
    positions, alphas, colors, scales, rotations, harmonics = bytes_of
    n = layout.count
    wide = np.zeros((3 * n, 4), np.uint8)
    wide[:, 1:] = positions.reshape(-1, 3)
    means = (wide.view("<i4") >> 8).astype(np.float64).reshape(n, 3) * 2.0**-layout.fractional_bits
    constant = (colors.reshape(n, 1, 3) / 255 - 0.5) / _COLOR_SCALE
    others = (layout.degree + 1) ** 2 - 1
    rest = (harmonics.reshape(n, others, 3).astype(np.float32) - 128) / 128
    gaussians = Gaussians(
        means.astype(np.float32),
        _unpack_rotations(rotations, layout.version),
        scales.reshape(n, 3) / _LOG_SCALE_STEPS - _LOG_SCALE_ZERO,
        logits_from_opacity(alphas / 255),
        np.concatenate([constant, rest], axis=1),
    )
    if _read_axes(path, records) == _AXES_TURNED:
        gaussians = transform_gaussians(gaussians, _DOWN_FROM_UP, 1.0, np.zeros(3))
    return SceneFile(gaussians, bool(layout.flags & _ANTIALIASED))


def _unpack_rotations(data: np.ndarray, version: int) -> np.ndarray:
    if version == 2:
        xyz = data.reshape(-1, 3) / 127.5 - 1
        w = np.sqrt(np.maximum(0.0, 1.0 - np.sum(xyz * xyz, axis=1)))
        return np.concatenate([w[:, None], xyz], axis=1)
    packed = np.ascontiguousarray(data).view("<u4")
    others = np.empty((len(packed), 3))
    for column, shift in enumerate((20, 10, 0)):
        value = packed >> np.uint32(shift)
        size = (value & 511) / _ROTATION_STEPS
        others[:, column] = np.where(value & 512, -size, size)
    return restore_largest((packed >> 30).astype(int), others)[:, [3, 0, 1, 2]]


def _check_header(
    path: Path, size: int, head: tuple[int, ...], versions: tuple[int, ...]
) -> _Layout:
    magic, *values = head
    layout = _Layout(*values[:5])
    if magic != _MAGIC:
        raise InputError(f"{path}: no SPZ file (it begins otherwise)")
    if layout.version in (2, 3) and layout.version not in versions:
        what = f"SPZ version {layout.version} without the gzip around it"
        raise InputError(f"{path}: {what}; compress it: gzip -c FILE > COPY.spz")
    if layout.version not in versions:
        raise InputError(f"{path}: SPZ version {layout.version}; gsut reads 2, 3 and 4")
    if layout.degree > 3:
        raise InputError(f"{path}: harmonics of degree {layout.degree}; gsut has 0 to 3")
    if layout.fractional_bits > _MOST_FRACTIONAL_BITS:
        raise InputError(
            f"{path}: damaged: the header's fractional bits are {layout.fractional_bits}, and a "
            f"position has {_MOST_FRACTIONAL_BITS} bits in all"
        )
    check_claim(path, layout.count, size)
    return layout


def _decompress_gzip(
    path: Path, data: bytes
) -> tuple[_Layout, list[bytes], list[tuple[int, bytes]]]:
    stream = zlib.decompressobj(16 + zlib.MAX_WBITS)
    try:
        head = stream.decompress(data, _HEADER.size)
        if len(head) < _HEADER.size:
            raise InputError(f"{path}: truncated in the header")
        layout = _check_header(path, len(data), _HEADER.unpack(head), (2, 3))
        sizes = layout.count_bytes()
        if sum(sizes) > _DEFLATE_MOST * len(data):
            raise InputError(
                f"{path}: claims {layout.count:,} Gaussians, more than {len(data):,} bytes of gzip "
                "can hold"
            )
        more = _MOST_EXTENDED if layout.flags & _EXTENDED else 0
        body = stream.decompress(stream.unconsumed_tail, sum(sizes) + more + 1)
    except zlib.error as error:
        raise InputError(f"{path}: damaged: {error}") from None
    records = []
    if layout.flags & _EXTENDED and len(body) > sum(sizes):
        records = _list_records(path, body[sum(sizes) :])
        body = body[: sum(sizes)]
    if len(body) != sum(sizes) or not stream.eof:
        raise InputError(
            f"{path}: {layout.count:,} Gaussians need {sum(sizes):,} bytes, {len(body):,} or more "
            "are there; it is truncated or damaged"
        )
    planes = [body[a:b] for a, b in itertools.pairwise(np.cumsum([0, *sizes]))]
    return layout, planes, records


def _decompress_zstandard(
    path: Path, data: bytes
) -> tuple[_Layout, list[bytes], list[tuple[int, bytes]]]:
    if len(data) < _HEADER_4.size:
        raise InputError(f"{path}: no SPZ file, or truncated in the header")
    *head, streams, table = _HEADER_4.unpack_from(data)
    layout = _check_header(path, len(data), tuple(head), (4,))
    sizes = layout.count_bytes()
    wanted = [size for size in sizes if size]
    begin = table + _ENTRY.size * streams
    if streams != len(wanted) or table < _HEADER_4.size or begin > len(data):
        raise InputError(
            f"{path}: {streams} streams listed at byte {table}; {len(wanted)} are needed"
        )
    planes, decompressor = [], _import_zstandard().ZstdDecompressor()
    for number, size in enumerate(wanted):
        small, large = _ENTRY.unpack_from(data, table + number * _ENTRY.size)
        piece = data[begin : begin + small]
        begin += small
        if large != size or len(piece) != small:
            raise InputError(
                f"{path}: stream {number} is to have {size:,} bytes and says {large:,}, of which "
                f"{len(piece):,} of {small:,} compressed ones are there"
            )
        try:
            with decompressor.stream_reader(piece) as reader:
                planes.append(reader.read(size + 1))
        except _import_zstandard().ZstdError as error:
            raise InputError(f"{path}: stream {number} is damaged: {error}") from None
        if len(planes[-1]) != size:
            raise InputError(f"{path}: stream {number} has not the {size:,} bytes that it says")
    planes += [b""] * (len(sizes) - len(planes))
    records = []
    if layout.flags & _EXTENDED:  # before the table, or behind the streams
        records = _list_records(path, data[_HEADER_4.size : table])
        records += _list_records(path, data[begin:])
    return layout, planes, records


def _list_records(path: Path, data: bytes) -> list[tuple[int, bytes]]:
    """Splits the records beside the Gaussians into kind and content.

    Raises:
        InputError: they are cut off.
    """
    records, place = [], 0
    while place < len(data):
        end = place + _RECORD.size
        kind, size = _RECORD.unpack_from(data, place) if end <= len(data) else (0, 0)
        place = end + size
        if place > len(data):
            raise InputError(f"{path}: truncated or damaged in the records beside its Gaussians")
        records.append((kind, data[end:place]))
    return records


def _read_axes(path: Path, records: list[tuple[int, bytes]]) -> str:
    """Reads the axes from the records, and warns of those that are not known.

    Raises:
        InputError: axes that gsut does not read, or contradicting records.
    """
    found = {content for kind, content in records if kind == _AXES}
    numbers = {int.from_bytes(content, "little") for content in found}
    names = {_AXES_NAMES[n] if n < len(_AXES_NAMES) else f"number {n}" for n in numbers}
    if any(len(content) != 4 for content in found) or len(names) > 1:
        raise InputError(f"{path}: damaged in the record of its coordinate system ({_AXES:#010x})")
    axes = names.pop() if names else _AXES_READ[0]
    if axes not in (*_AXES_READ, _AXES_TURNED):
        raise InputError(
            f"{path}: its coordinate system is {axes} (record {_AXES:#010x}), and gsut reads "
            f"{', '.join(_AXES_READ)} and {_AXES_TURNED}; save it with one of these"
        )
    unknown = [f"{kind:#010x}" for kind, _ in records if kind not in (_ORBIT, _AXES)]
    if unknown:
        warnings.warn(
            f"{path}: its extensions {', '.join(unknown)} are not read; one of them may say that "
            "the scene has other axes",
            stacklevel=3,
        )
    return axes


FORMAT = Format(
    "SPZ",
    (".spz",),
    _write,
    _read,
    lambda head: head.startswith(_GZIP) or head.startswith(struct.pack("<I", _MAGIC)),
)
