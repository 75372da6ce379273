"""Kalibr's camchain YAML files, and EuRoC's sensor.yaml: one camera with the same keys."""

from __future__ import annotations

import re
from typing import Any

from gsut._core import CalibrationError
from gsut.lens.camera import Camera
from gsut.lens.files._format import KEYED, LensFile, LensFormat
from gsut.lens.files._values import FROM_ZERO, LensValues, choose_name, refuse_lens, skip_to

_CAMERA_NAME = re.compile(r"cam\d+$")
# gsut's lens and the number of coefficients of each camera_model and distortion_model, by the names
# of Kalibr and of EuRoC.
_LENSES = {
    ("pinhole", "none"): ("pinhole", 0),
    ("pinhole", "radtan"): ("opencv4", 4),
    ("pinhole", "radial-tangential"): ("opencv4", 4),
    ("pinhole", "plumb_bob"): ("opencv4", 4),
    ("pinhole", "equi"): ("kannala_brandt", 4),
    ("pinhole", "equidistant"): ("kannala_brandt", 4),
    ("pinhole", "fov"): ("fov", 1),
    ("omni", "none"): ("mei", 0),
    ("omni", "radtan"): ("mei", 4),
    ("ds", "none"): ("double_sphere", 0),
    ("eucm", "none"): ("extended_unified", 0),
}
# Intrinsics before fu fv pu pv.
_LEADING = {"pinhole": 0, "omni": 1, "ds": 2, "eucm": 2}
_NUM_FISHEYE = 4  # coefficients of "equi": k1 to k4


def is_camchain(values: dict[str, Any]) -> bool:
    """Returns whether the top level of a file has cameras as Kalibr names them."""
    return any(_CAMERA_NAME.match(str(key)) for key in values)


def read_kalibr(file: LensFile, camera_id: int | str | None) -> Camera:
    """Reads the only camera of a camchain, or the one with this name ("cam1" or 1)."""
    values, source = file.values, file.source
    names = [str(key) for key in values if _CAMERA_NAME.match(str(key))]
    numbered = str(camera_id).isdigit()
    wanted = choose_name(names, f"cam{camera_id}" if numbered else camera_id, source)
    entry = values[wanted]
    if not isinstance(entry, dict):
        raise CalibrationError(f"{source}, key '{wanted}': expected a dictionary, found {entry!r}")
    return camera_from_kalibr(LensValues(entry, source, skip_to(file.text, f"{wanted}:")))


def _is_euroc(file: LensFile) -> bool:
    return {"intrinsics", "camera_model", "resolution"} <= file.values.keys()


def camera_from_kalibr(reader: LensValues) -> Camera:
    """Makes the camera of one entry of a camchain, or of a sensor.yaml."""
    model = str(reader.values[reader.require("camera_model")]).lower()
    if model not in _LEADING:
        known = ", ".join(_LEADING)
        reader.fail("camera_model", f"{model!r} is not supported; supported: {known}")
    size = reader.read_size("resolution")
    distortion = str(reader.values.get("distortion_model") or "none").lower()
    if (model, distortion) not in _LENSES:
        known = ", ".join(name for camera, name in _LENSES if camera == model)
        reader.fail("distortion_model", f"{distortion!r} is not supported; supported: {known}")
    lens, count = _LENSES[model, distortion]
    leading = _LEADING[model]
    intrinsics = reader.read_numbers("intrinsics", leading + 4)
    own, (fx, fy, cx, cy) = intrinsics[:leading], intrinsics[leading:]
    given = reader.find("distortion_coeffs", "distortion_coefficients") or "distortion_coeffs"
    coefficients = reader.read_numbers(given, count) if count else []
    if lens == "mei":
        own, coefficients = [0.0, *own], coefficients or [0.0] * 4  # no skew
    params = [fx, fy, cx + FROM_ZERO, cy + FROM_ZERO, *own, *coefficients]
    keys = [*(len(params) - len(coefficients)) * ["intrinsics"], *len(coefficients) * [given]]
    return reader.make_camera(lens, params, *size, keys=keys)


def format_kalibr(camera: Camera) -> str:
    """Formats a camchain with this camera as cam0."""
    return "cam0:\n" + "".join(f"  {k}: {v}\n" for k, v in to_kalibr(camera).items())


def to_kalibr(camera: Camera) -> dict[str, str]:
    """Returns the keys of one camera of a camchain, with their values as text.

    Raises:
        InputError: Kalibr has no such lens.
    """
    if camera.model == "equirectangular":
        raise refuse_lens("Kalibr", camera)
    values = [float(value) for value in camera.params]
    fx, fy, cx, cy, *rest = values
    model, distortion, own, coefficients = "pinhole", "none", [], rest
    if camera.model == "opencv4" or (camera.model == "opencv5" and rest[4] == 0.0):
        distortion, coefficients = "radtan", rest[:4]
    elif camera.model == "fov":
        distortion = "fov"
    elif camera.model == "kannala_brandt" and len(rest) <= _NUM_FISHEYE:
        distortion, coefficients = "equi", rest + [0.0] * (_NUM_FISHEYE - len(rest))
    elif camera.model == "double_sphere":
        model, own, coefficients = "ds", rest, []
    elif camera.model in ("extended_unified", "unified"):
        model, own, coefficients = "eucm", [rest[0], *(rest[1:] or [1.0])], []
    elif camera.model == "mei" and rest[0] == 0.0:
        model, distortion, own, coefficients = "omni", "radtan", [rest[1]], rest[2:]
    elif camera.model != "pinhole":
        raise refuse_lens("Kalibr", camera)
    intrinsics = [*own, fx, fy, cx - FROM_ZERO, cy - FROM_ZERO]
    return {
        "camera_model": model,
        "intrinsics": _format_list(intrinsics),
        "distortion_model": distortion,
        "distortion_coeffs": _format_list(coefficients),
        "resolution": f"[{camera.width}, {camera.height}]",
    }


def _format_list(values: list[float]) -> str:
    return "[" + ", ".join(f"{value:.16e}" for value in values) + "]"


FORMATS = (
    LensFormat(
        "kalibr",
        "Kalibr",
        KEYED,
        read_kalibr,
        lambda file: is_camchain(file.values),
        marks="cam0",
        rank=20,
        write=lambda camera, suffix: format_kalibr(camera),
        names=("*camchain*.yaml", "*camchain*.yml"),
        has_ids=True,
    ),
    LensFormat(
        "euroc",
        "EuRoC",
        KEYED,
        lambda file, camera_id: camera_from_kalibr(LensValues(file.values, file.source, file.text)),
        _is_euroc,
        marks="camera_model and intrinsics",
        rank=30,
    ),
)
