"""gsut's own lens file: a JSON object of model, params and size, for every lens there is."""

from __future__ import annotations

import json
from typing import Any

from gsut.lens.camera import Camera
from gsut.lens.files._format import KEYED, LensFormat
from gsut.lens.files._values import LensValues

OWN_SUFFIX = ".lens.json"  # ending of a file's name that chooses this format
_OPTIONAL = ("valid_field_angle", "extrinsics", "valid_region")


def values_from_camera(camera: Camera) -> dict[str, Any]:
    """Returns a camera as values for JSON, which `camera_from_values` reads without loss."""
    values: dict[str, Any] = {
        "model": camera.model,
        "params": [float(value) for value in camera.params],
        "width": camera.width,
        "height": camera.height,
        "valid_field_angle": camera.valid_field_angle,
    }
    for key in ("extrinsics", "valid_region"):
        array = getattr(camera, key)
        if array is not None:
            values[key] = array.tolist()
    return values


def camera_from_values(values: dict[str, Any], source: str = "", text: str = "") -> Camera:
    """Makes the camera of `values_from_camera`.

    Args:
        values: model (see `camera_models`), params in its order, width, height; if known
            valid_field_angle in radians, extrinsics (6 numbers) and valid_region (pixel pairs).
        source: the file's name, for messages.
        text: the file's text, to name lines in messages.

    Raises:
        CalibrationError: a key is missing or no finite number, or the lens is unknown.
    """
    reader = LensValues(values, source, text)
    model = str(values[reader.require("model")])
    size = reader.read_pixels(reader.require("width")), reader.read_pixels(reader.require("height"))
    known = {key for key in _OPTIONAL if values.get(key) is not None}
    limit = reader.read_number("valid_field_angle") if "valid_field_angle" in known else None
    camera = reader.make_camera(
        model, reader.read_numbers(reader.require("params")), *size, limit, "params"
    )
    if not known - {"valid_field_angle"}:
        return camera
    extrinsics = reader.read_numbers("extrinsics", 6) if "extrinsics" in known else None
    region = reader.read_numbers("valid_region") if "valid_region" in known else None
    if region is not None and len(region) % 2:
        reader.fail("valid_region", f"expected pairs of pixels, found {len(region)} numbers")
    pairs = None if region is None else [region[i : i + 2] for i in range(0, len(region), 2)]
    return Camera(
        model, camera.params, *size, valid_field_angle=limit, extrinsics=extrinsics,
        valid_region=pairs,
    )  # fmt: skip


def format_own(camera: Camera) -> str:
    """Formats a lens file; its `param_names` explain the numbers to people and are not read."""
    values = values_from_camera(camera)
    return json.dumps({**values, "param_names": camera.param_names}, indent=1) + "\n"


FORMAT = LensFormat(
    "gsut",
    "gsut",
    KEYED,
    lambda file, camera_id: camera_from_values(file.values, file.source, file.text),
    lambda file: "model" in file.values and "params" in file.values,
    marks="model and params",
    rank=70,
    write=lambda camera, suffix: format_own(camera),
    names=(f"*{OWN_SUFFIX}",),
)
