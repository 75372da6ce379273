"""Intrinsics in nerfstudio's transforms.json."""

from __future__ import annotations

import json
import math
from typing import Any

from gsut._core import InputError
from gsut.lens.camera import Camera
from gsut.lens.files.values import LensValues

_DISTORTION_KEYS = ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2")
_INTRINSIC_KEYS = (
    "camera_model",
    "is_fisheye",
    "fl_x",
    "fl_y",
    "cx",
    "cy",
    "w",
    "h",
    "camera_angle_x",
    "camera_angle_y",
    "max_theta_rad",
    "distortion_params",
    *_DISTORTION_KEYS,
)
_PERSPECTIVE = ("OPENCV", "SIMPLE_RADIAL", "RADIAL")
_FISHEYE = ("OPENCV_FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE")
_PINHOLE = ("PINHOLE", "SIMPLE_PINHOLE", "PERSPECTIVE")
_KNOWN = (*_PINHOLE, *_PERSPECTIVE, "FULL_OPENCV", *_FISHEYE, "FISHEYE624", "EQUIRECTANGULAR")
_SUPPORTED = ", ".join(_KNOWN)
# k0 to k5, p0, p1, s0 to s3 under one key.
_FISHEYE624_KEY = "distortion_params"
_NUM_FISHEYE624 = 12


def nerfstudio_camera(values: dict[str, Any], source: str = "", text: str = "") -> Camera:
    """The camera of one frame of a transforms.json.

    Args:
        values: the file's top level with the frame's own keys merged over it. camera_model (absent:
            OPENCV_FISHEYE if is_fisheye, else OPENCV if any distortion is given, else PINHOLE);
            w, h in pixels; fl_x, fl_y in pixels, or camera_angle_x, camera_angle_y, the full field
            of view in radians (the y value defaults to the x one); cx, cy (default: the centre) in
            gsut's pixel convention; k1.. p1 p2; max_theta_rad, the valid field angle in radians.
        source: the file's name, for messages.
        text: the file's text, to name lines in messages.

    Returns:
        The camera: `pinhole`; OPENCV is `opencv4`, or `opencv5` if k3 is not 0; FULL_OPENCV is
        `opencv8`; the fisheyes are `kannala_brandt`; FISHEYE624 (with distortion_params, 12
        numbers) and EQUIRECTANGULAR (w and h only) are the lenses of these names.

    Raises:
        CalibrationError: a key is missing or no finite number, or the model is not supported.
    """
    reader = LensValues(values, source, text)
    width, height = reader.pixels("w"), reader.pixels("h")
    if _model_name(reader) == "EQUIRECTANGULAR":  # files give focal lengths that mean nothing
        return reader.camera("equirectangular", [], width, height)
    fl_x = _focal(reader, "fl_x", "camera_angle_x", width)
    # Square pixels unless the file says otherwise.
    has_own_y = any(values.get(key) is not None for key in ("fl_y", "camera_angle_y"))
    fl_y = _focal(reader, "fl_y", "camera_angle_y", height) if has_own_y else fl_x
    params = [fl_x, fl_y, reader.number("cx", width / 2), reader.number("cy", height / 2)]
    k1, k2, k3, k4, k5, k6, p1, p2 = (reader.number(key, 0.0) for key in _DISTORTION_KEYS)
    limit = reader.number("max_theta_rad") if values.get("max_theta_rad") is not None else None

    model = _model_name(reader)
    if model == "FISHEYE624":
        params += reader.numbers(reader.need(_FISHEYE624_KEY), _NUM_FISHEYE624)
        return reader.camera("fisheye624", params, width, height, limit)
    if model in _PINHOLE:
        if any(reader.number(key, 0.0) != 0.0 for key in _DISTORTION_KEYS):
            reader.fail("camera_model", f"is {model}, yet the file gives distortion; use OPENCV")
        return reader.camera("pinhole", params, width, height, limit)
    if model in _PERSPECTIVE:
        if (k4, k5, k6) != (0.0, 0.0, 0.0):
            reader.fail(
                "k4",
                "means r^8 to nerfstudio and the denominator to OpenCV; set k4 to k6 to 0, or"
                " camera_model to FULL_OPENCV for OpenCV's meaning",
            )
        if k3 != 0.0:
            return reader.camera("opencv5", [*params, k1, k2, p1, p2, k3], width, height, limit)
        return reader.camera("opencv4", [*params, k1, k2, p1, p2], width, height, limit)
    if model == "FULL_OPENCV":
        full = [*params, k1, k2, p1, p2, k3, k4, k5, k6]
        return reader.camera("opencv8", full, width, height, limit)
    for key, value in (("k5", k5), ("k6", k6), ("p1", p1), ("p2", p2)):
        if value != 0.0:
            reader.fail(key, f"is {value:g}, but {model} has k1 to k4 only")
    return reader.camera("kannala_brandt", [*params, k1, k2, k3, k4], width, height, limit)


def _model_name(reader: LensValues) -> str:
    model = reader.values.get("camera_model")
    if model is None:
        if reader.values.get("is_fisheye"):
            return "OPENCV_FISHEYE"
        distorted = any(reader.values.get(key) for key in _DISTORTION_KEYS)
        return "OPENCV" if distorted else "PINHOLE"
    if model not in _KNOWN:
        reader.fail("camera_model", f"{model!r} is not supported; supported: {_SUPPORTED}")
    return str(model)


def _focal(reader: LensValues, key: str, angle_key: str, size: int) -> float:
    if reader.values.get(key) is not None:
        return reader.number(key)
    if reader.values.get(angle_key) is None:
        reader.fail(key, f"is missing (and so is {angle_key}); add the focal length in pixels")
    angle = reader.number(angle_key)
    if not 0.0 < angle < math.pi:
        reader.fail(angle_key, f"expected radians between 0 and pi, found {angle:g}")
    return 0.5 * size / math.tan(0.5 * angle)


def load_nerfstudio(values: dict[str, Any], source: str, text: str) -> Camera:
    """The one camera that all frames of a transforms.json share."""
    frames = values.get("frames")
    cameras: list[Camera] = []
    for frame in frames if isinstance(frames, list) else []:
        own = {
            key: frame[key] for key in _INTRINSIC_KEYS if isinstance(frame, dict) and key in frame
        }
        camera = nerfstudio_camera({**values, **own}, source, text) if own else None
        if camera is not None and camera not in cameras:
            cameras.append(camera)
    if len(cameras) > 1:
        raise InputError(
            f"{source}: its frames have {len(cameras)} different cameras; load it as a data set"
        )
    return cameras[0] if cameras else nerfstudio_camera(values, source, text)


def format_nerfstudio(camera: Camera) -> str:
    """The text of a transforms.json that holds this camera and no frames.

    Raises:
        InputError: nerfstudio has no such lens.
    """
    names = {
        "pinhole": ("PINHOLE", ()),
        "opencv4": ("OPENCV", ("k1", "k2", "p1", "p2")),
        "opencv5": ("OPENCV", ("k1", "k2", "p1", "p2", "k3")),
        "opencv8": ("FULL_OPENCV", ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")),
        "kannala_brandt": ("OPENCV_FISHEYE", ("k1", "k2", "k3", "k4")),
    }
    name, keys = names.get(camera.model, ("", ()))
    coefficients = [float(value) for value in camera.params[4:]]
    values: dict[str, Any] = {"camera_model": name, "w": camera.width, "h": camera.height}
    if camera.model == "equirectangular":
        values["camera_model"] = "EQUIRECTANGULAR"
        return json.dumps(values, indent=2) + "\n"
    if camera.model == "fisheye624":
        values["camera_model"] = name = "FISHEYE624"
        values[_FISHEYE624_KEY], coefficients = coefficients, []
    if not name or len(coefficients) > len(keys):
        raise InputError(
            f"nerfstudio has no camera model for '{camera.model}' with {len(camera.params)}"
            " parameters; save a .cameramodel or OpenCV file instead"
        )
    coefficients += [0.0] * (len(keys) - len(coefficients))
    values.update(zip(("fl_x", "fl_y", "cx", "cy"), map(float, camera.params[:4]), strict=True))
    values.update(zip(keys, coefficients, strict=True))
    if camera.valid_field_angle is not None:
        values["max_theta_rad"] = camera.valid_field_angle
    return json.dumps(values, indent=2) + "\n"
