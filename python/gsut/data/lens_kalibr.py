"""Kalibr's camchain YAML files."""

from __future__ import annotations

import re
from typing import Any

from gsut._core import CalibrationError, InputError
from gsut.cameras import Camera
from gsut.data.lens_values import LensValues

# Kalibr's pixel (0, 0) is gsut's (0.5, 0.5).
_PIXEL_SHIFT = 0.5
_CAMERA_NAME = re.compile(r"cam\d+$")
_LENSES = {"radtan": "opencv4", "equi": "kannala_brandt", "equidistant": "kannala_brandt"}
_NUM_COEFFICIENTS = 4


def is_camchain(values: dict[str, Any]) -> bool:
    """Whether the top level of a file has cameras as Kalibr names them."""
    return any(_CAMERA_NAME.match(str(key)) for key in values)


def load_kalibr(values: dict[str, Any], source: str, text: str, camera_id: Any) -> Camera:
    """The only camera of a camchain, or the one of this name ("cam1" or 1)."""
    names = [str(key) for key in values if _CAMERA_NAME.match(str(key))]
    if camera_id is None and len(names) > 1:
        raise InputError(
            f"{source}: holds {len(names)} cameras; give camera_id, one of {', '.join(names)}"
        )
    wanted = names[0] if camera_id is None else str(camera_id)
    if wanted.isdigit():
        wanted = f"cam{wanted}"
    if wanted not in names:
        raise InputError(f"{source}: has no camera {camera_id}; it holds {', '.join(names)}")
    entry = values[wanted]
    if not isinstance(entry, dict):
        raise CalibrationError(f"{source}, key '{wanted}': expected a dictionary, found {entry!r}")
    # Lines are searched in this camera's part of the text.
    start = text.find(f"{wanted}:")
    reader = LensValues(entry, source, "\n" * text.count("\n", 0, start) + text[max(start, 0) :])
    return _camera(reader)


def _camera(reader: LensValues) -> Camera:
    model = reader.values[reader.need("camera_model")]
    if model != "pinhole":
        reader.fail("camera_model", f"{model!r} is not supported; supported: pinhole")
    width, height = reader.numbers("resolution", 2)
    sizes = LensValues({"resolution": width, "height": height}, reader.source, reader.text)
    size = sizes.pixels("resolution"), sizes.pixels("height")
    fx, fy, cx, cy = reader.numbers("intrinsics", 4)
    params = [fx, fy, cx + _PIXEL_SHIFT, cy + _PIXEL_SHIFT]
    distortion = reader.values.get("distortion_model")
    if distortion in (None, "none"):
        return reader.camera("pinhole", params, *size)
    if distortion not in _LENSES:
        known = ", ".join((*_LENSES, "none"))
        reader.fail("distortion_model", f"{distortion!r} is not supported; supported: {known}")
    coefficients = reader.numbers("distortion_coeffs", _NUM_COEFFICIENTS)
    return reader.camera(_LENSES[distortion], params + coefficients, *size)


def format_kalibr(camera: Camera) -> str:
    """The text of a camchain with this camera as cam0.

    Raises:
        InputError: Kalibr has no such lens.
    """
    names = {"pinhole": "none", "opencv4": "radtan", "kannala_brandt": "equi"}
    fx, fy, cx, cy, *coefficients = (float(value) for value in camera.params)
    if camera.model not in names or len(coefficients) > _NUM_COEFFICIENTS:
        raise InputError(
            f"Kalibr has no camera model for '{camera.model}' with {len(camera.params)}"
            " parameters; save a .cameramodel or OpenCV file instead"
        )
    if camera.model != "pinhole":
        coefficients += [0.0] * (_NUM_COEFFICIENTS - len(coefficients))
    intrinsics = [fx, fy, cx - _PIXEL_SHIFT, cy - _PIXEL_SHIFT]
    return (
        "cam0:\n"
        "  camera_model: pinhole\n"
        f"  intrinsics: {_list(intrinsics)}\n"
        f"  distortion_model: {names[camera.model]}\n"
        f"  distortion_coeffs: {_list(coefficients)}\n"
        f"  resolution: [{camera.width}, {camera.height}]\n"
    )


def _list(values: list[float]) -> str:
    return "[" + ", ".join(f"{value:.16e}" for value in values) + "]"
