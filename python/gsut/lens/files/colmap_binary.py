"""COLMAP's cameras.bin."""

from __future__ import annotations

import struct

from gsut._core import CalibrationError
from gsut.lens.camera import Camera
from gsut.lens.files._format import LensFormat
from gsut.lens.files.colmap import (
    PARAMETER_COUNTS,
    SUPPORTED,
    ColmapCamera,
    choose_camera,
    require_one_each,
    to_colmap,
)


def list_binary_cameras(data: bytes, source: str) -> list[ColmapCamera]:
    """Lists the cameras of a cameras.bin.

    Raises:
        CalibrationError: names the camera at whose place the file ends or cannot be understood.
    """
    position, count = 0, 0
    found: list[ColmapCamera] = []

    def take(layout: str) -> tuple:
        nonlocal position
        size = struct.calcsize(layout)
        if position + size > len(data):
            place = f"camera {len(found) + 1} of {count}" if count else "its header"
            raise CalibrationError(
                f"{source}: the file ends at byte {len(data)}, in {place}, which starts at or"
                f" before byte {position}; copy or export it again"
            )
        values = struct.unpack_from(layout, data, position)
        position += size
        return values

    (count,) = take("<Q")
    while len(found) < count:
        where = f"{source}, byte {position}, camera {len(found) + 1} of {count}"
        key, number, width, height = take("<IiQQ")
        if number not in PARAMETER_COUNTS:
            raise CalibrationError(
                f"{where}: unknown camera model {number}; supported: {SUPPORTED}"
            )
        params = list(take(f"<{PARAMETER_COUNTS[number]}d"))
        found.append(ColmapCamera(key, number, width, height, params, where))
    if position != len(data):
        raise CalibrationError(
            f"{source}: {len(data) - position} bytes are left after {count} camera records, at byte"
            f" {position}; the file may be of another COLMAP version or damaged: export it again"
        )
    return require_one_each(found)


def format_colmap_binary(camera: Camera) -> bytes:
    """Formats a cameras.bin with this camera as number 1."""
    _, number, params = to_colmap(camera)
    head = struct.pack("<QIiQQ", 1, 1, number, camera.width, camera.height)
    return head + struct.pack(f"<{len(params)}d", *params)


FORMAT = LensFormat(
    "colmap-binary",
    "COLMAP",
    (".bin",),
    lambda file, camera_id: choose_camera(
        list_binary_cameras(file.data, file.source), file.source, camera_id
    ),
    write=lambda camera, suffix: format_colmap_binary(camera),
    names=("*.bin",),
    has_ids=True,
)
