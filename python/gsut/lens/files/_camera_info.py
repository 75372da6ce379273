"""Lenses from and to the fields of ROS' message sensor_msgs/CameraInfo."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.bounds import name_wrong_kinds, show
from gsut.lens.camera import Camera
from gsut.lens.files._format import LensFile
from gsut.lens.files.opencv import read_opencv, to_opencv

# Our lenses that a CameraInfo holds: ROS' name and the number of coefficients in D.
_MODELS = {
    "pinhole": ("plumb_bob", 5),
    "opencv4": ("plumb_bob", 5),
    "opencv5": ("plumb_bob", 5),
    "opencv8": ("rational_polynomial", 8),
    "kannala_brandt": ("equidistant", 4),
}
_NO_ROI = {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False}


@name_wrong_kinds
def camera_from_info(message: Any, *, rectified: bool = False, topic: str = "CameraInfo") -> Camera:
    """Makes the lens of a CameraInfo.

    Args:
        message: of ROS 1 or 2, or a dict of its fields: width, height, distortion_model, D, K and P
            (or d, k, p); binning and roi may be absent.
        rectified: the pictures are rectified: then P, without distortion, is their lens.
        topic: for messages of errors.

    Returns:
        pinhole, opencv4 to opencv14, or kannala_brandt.

    Raises:
        InputError: the camera is not calibrated, or the pictures are a part of its.
        CalibrationError: a distortion that gsut does not have.
    """
    text = json.dumps(_read_values(message, topic, rectified))
    return read_opencv(LensFile(Path("CameraInfo.json"), topic, text.encode()), None)


@name_wrong_kinds
def info_from_camera(camera: Camera) -> dict[str, Any]:
    """Returns the fields of the CameraInfo of a lens, without header.

    The message has no place for the valid field angle.

    Args:
        camera: pinhole, opencv4, opencv5, opencv8, or kannala_brandt of up to four coefficients.

    Returns:
        dict with the field names of ROS 2, ready for `CameraInfo(**fields)` but for roi, which is a
        dict as well: height, width, distortion_model, d, k, r, p, binning_x, binning_y, roi.

    Raises:
        InputError: a CameraInfo cannot hold this lens.
    """
    if camera.model not in _MODELS:
        raise InputError(
            f"CameraInfo holds {', '.join(_MODELS)}, not {camera.model}; fit one of them with "
            "gsut.lens.convert_camera"
        )
    name, count = _MODELS[camera.model]
    _, matrix, coefficients = to_opencv(camera)
    fx, _, cx, _, fy, cy, *_ = matrix
    return {
        "height": camera.height,
        "width": camera.width,
        "distortion_model": name,
        "d": coefficients + [0.0] * (count - len(coefficients)),
        "k": matrix,
        "r": np.eye(3).ravel().tolist(),
        "p": [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
        "binning_x": 0,
        "binning_y": 0,
        "roi": dict(_NO_ROI),
    }


def _read_values(message: Any, where: str, rectified: bool) -> dict[str, Any]:
    """Returns the keys and values that a lens file of OpenCV's has for this lens."""
    if isinstance(message, Mapping):
        message = SimpleNamespace(**message)
    k, d, p = (np.ravel(_get_either(message, name)) for name in ("k", "d", "p"))
    matrix = np.reshape(p, (3, 4))[:, :3] if rectified else np.reshape(k, (3, 3))
    if not matrix.any():
        raise InputError(
            f"{where}: the camera is not calibrated ({'P' if rectified else 'K'} is all zero); "
            "give its lens with --lens"
        )
    roi = getattr(message, "roi", _NO_ROI)
    roi = SimpleNamespace(**roi) if isinstance(roi, Mapping) else roi
    parts = {"binning_x": getattr(message, "binning_x", 0) > 1,
             "binning_y": getattr(message, "binning_y", 0) > 1,
             "roi": bool(roi.x_offset or roi.y_offset)}  # fmt: skip
    for name, is_part in parts.items():
        if is_part:
            raise InputError(
                f"{where}: '{name}' says that the pictures are a part of the camera's, or smaller; "
                "give the lens of these pictures with --lens"
            )
    return {
        "image_width": int(_get_either(message, "width")),
        "image_height": int(_get_either(message, "height")),
        "distortion_model": "plumb_bob"
        if rectified
        else str(_get_either(message, "distortion_model")),
        "camera_matrix": matrix.ravel().tolist(),
        "distortion_coefficients": [] if rectified else d.tolist(),
    }


def _get_either(message: Any, name: str) -> Any:
    """Returns a field whose name ROS 1 writes with a capital letter and ROS 2 with a small one."""
    found = getattr(message, name, getattr(message, name.upper(), None))
    if found is None:
        raise InputError(f"a CameraInfo has '{name}', which {show(message)} has not")
    return found
