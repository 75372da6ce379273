"""COLMAP's cameras.bin."""

from __future__ import annotations

import struct

from gsut._core import CalibrationError
from gsut.lens.camera import Camera
from gsut.lens.files._format import LensFile, LensFormat
from gsut.lens.files.colmap import (
    MODEL_NAMES,
    PARAMETER_COUNTS,
    SUPPORTED,
    WRITTEN_MODELS,
    Record,
    choose_camera,
    to_colmap,
)


def read_colmap_binary(file: LensFile, camera_id: int | str | None) -> Camera:
    """Reads the only camera of a cameras.bin, or the one with this number."""
    data, source, position = file.data, file.source, 0

    def take(layout: str) -> tuple:
        nonlocal position
        size = struct.calcsize(layout)
        if position + size > len(data):
            raise CalibrationError(
                f"{source}: cut off at byte {len(data)} in camera {len(records) + 1}; copy or"
                " export it again"
            )
        values = struct.unpack_from(layout, data, position)
        position += size
        return values

    records: list[Record] = []
    (count,) = take("<Q")
    while len(records) < count:
        where = f"{source}, camera {len(records) + 1} of {count}"
        key, number, width, height = take("<IiQQ")
        name = MODEL_NAMES.get(number)
        if name is None:
            raise CalibrationError(
                f"{where}: unknown camera model number {number}; supported: {SUPPORTED}"
            )
        params = list(take(f"<{PARAMETER_COUNTS[number]}d"))
        records.append(Record(key, name, width, height, params, where))
    return choose_camera(records, source, camera_id)


def format_colmap_binary(camera: Camera) -> bytes:
    """Formats a cameras.bin with this camera as number 1.

    Raises:
        InputError: COLMAP has no such lens.
    """
    _, number, params = to_colmap(camera)
    head = struct.pack("<QIiQQ", 1, 1, number, camera.width, camera.height)
    return head + struct.pack(f"<{len(params)}d", *params)


FORMAT = LensFormat(
    "colmap-binary",
    "COLMAP",
    (".bin",),
    read_colmap_binary,
    write=lambda camera, suffix: format_colmap_binary(camera),
    names=("*.bin",),
    models=WRITTEN_MODELS,
)
