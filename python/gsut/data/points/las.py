"""Point clouds of laser scanners: LAS by a reader of its own, LAZ by laspy where installed."""

from __future__ import annotations

import os
import struct

import numpy as np

from gsut.data.errors import DatasetError
from gsut.files import check_regular, read_bytes, register_reader

# The header's fields that are read (ASPRS, LAS 1.4 R15, table 3): bytes from its start. A point is
# a number of steps along each axis; version 1.4 counts points by 64 bits.
_HEADER = np.dtype({
    "names": ["minor", "start", "kind", "size", "count", "steps", "zero"],
    "formats": ["u1", "<u4", "u1", "<u2", "<u4", ("<f8", 3), ("<f8", 3)],
    "offsets": [25, 96, 104, 105, 107, 131, 155],
    "itemsize": 227,
})  # fmt: skip
_COLORS_AT = {2: 20, 3: 28, 5: 28, 7: 30, 8: 30, 10: 30}  # in a point of each format with colours
_DEEP = 256  # levels of 16 bits to one of 8
_ADVICE = "copy or export the cloud again"


@register_reader("laser scan", ".las", ".laz", advice=_ADVICE, fails=DatasetError)
def load_points_las(path: str | os.PathLike[str]) -> tuple[np.ndarray, np.ndarray | None]:
    """Reads a point cloud from a LAS file of version 1.0 to 1.4, or a LAZ file.

    Returns:
        points (N, 3) float64 in the file's coordinates, colors (N, 3) uint8 or None without.

    Raises:
        DatasetError: no such file, cut off, or compressed and laspy is not installed.
    """
    content = read_bytes(path)
    if len(content) < _HEADER.itemsize or not content.startswith(b"LASF"):
        raise DatasetError(path, "is no LAS file", _ADVICE)
    header = np.frombuffer(content, _HEADER, 1)[0]
    start, kind, size, count = (int(header[name]) for name in ("start", "kind", "size", "count"))
    if kind & 0x80:  # compressed
        return _read_laz(path)
    if header["minor"] >= 4:
        (count,) = struct.unpack_from("<Q", content, 247)  # of 64 bits
    if start + count * size > len(content):
        raise DatasetError(
            path, f"has {len(content):,} bytes, too few for its {count:,} points", _ADVICE
        )
    rows = np.frombuffer(content, np.uint8, count * size, start).reshape(count, size)
    places = np.ascontiguousarray(rows[:, :12]).view("<i4")
    points = places * header["steps"] + header["zero"]
    at = _COLORS_AT.get(kind)
    if at is None:
        return points, None
    return points, _to_bytes(np.ascontiguousarray(rows[:, at : at + 6]).view("<u2"))


def _read_laz(path: str | os.PathLike[str]) -> tuple[np.ndarray, np.ndarray | None]:
    try:
        import laspy
    except ImportError:
        raise DatasetError(
            path, "is compressed (LAZ)",
            'install its reader: pip install "gsut[lidar]"; or export LAS or PLY',
        ) from None  # fmt: skip
    cloud = laspy.read(check_regular(path))
    points = np.stack([np.asarray(cloud[axis], np.float64) for axis in "xyz"], axis=1)
    if "red" not in cloud.point_format.dimension_names:
        return points, None
    return points, _to_bytes(np.stack([cloud.red, cloud.green, cloud.blue], axis=1))


def _to_bytes(colors: np.ndarray) -> np.ndarray:
    """Returns colours of 16 bits as 8; some programs write 8 into them."""
    deep = colors.max(initial=0) >= _DEEP
    return (colors // _DEEP if deep else colors).astype(np.uint8)
