"""mrcal's .cameramodel files."""

from __future__ import annotations

import re

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.lens.camera import Camera
from gsut.lens.files._format import LensFile, LensFormat
from gsut.lens.files._values import LensValues

# What mrcal's own tools need to find a lens' uncertainty: each on a line, kept as it is.
_SOLVED = re.compile(r"""^[ \t]*['"](?:optimization_inputs|icam_intrinsics\w*)['"]\s*:.*$""", re.M)


def read_mrcal(file: LensFile, camera_id: int | str | None) -> Camera:
    """Reads the camera with its pose, its trusted region and what it was solved from."""
    core, extrinsics, valid_region = _core.parse_camera_model(file.text, file.source)
    try:
        camera = Camera(
            core.model,
            core.params,
            core.width,
            core.height,
            valid_field_angle=core.valid_field_angle,
            extrinsics=extrinsics,
            # No polygon means unknown; an empty one means that mrcal trusts no pixel.
            valid_region=None if valid_region is None else np.reshape(valid_region, (-1, 2)),
        )
        camera.solved_from = tuple(line.rstrip(", \t") for line in _SOLVED.findall(file.text))
        return camera
    except InputError as error:
        LensValues({}, file.source, file.text).fail("intrinsics", str(error))


def format_mrcal(camera: Camera) -> str:
    """Formats a lens as a .cameramodel."""
    extrinsics = [0.0] * 6 if camera.extrinsics is None else list(camera.extrinsics)
    region = None if camera.valid_region is None else camera.valid_region.tolist()
    text = _core.format_camera_model(camera, extrinsics, region)
    end = text.rindex("}")
    return text[:end] + "".join(f"{line},\n" for line in camera.solved_from) + text[end:]


FORMAT = LensFormat(
    "mrcal",
    "mrcal",
    (".cameramodel",),
    read_mrcal,
    write=lambda camera, suffix: format_mrcal(camera),
    names=("*.cameramodel",),
)
