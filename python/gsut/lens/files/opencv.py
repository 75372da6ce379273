"""OpenCV's FileStorage lens files (YAML and JSON), and ROS camera_info, which looks the same."""

from __future__ import annotations

import re

import numpy as np

from gsut.lens.camera import Camera
from gsut.lens.files._format import KEYED, LensFile, LensFormat, is_opencv_xml
from gsut.lens.files._values import FROM_ZERO, LensValues, refuse_lens

_MATRIX_KEYS = ("camera_matrix", "K", "cameraMatrix", "intrinsic_matrix", "M1", "mtx")
_OPEN3D_KEY = "intrinsic_matrix"  # Open3D's PinholeCameraIntrinsic stores it by columns
_DISTORTION_KEYS = (
    "distortion_coefficients", "D", "distCoeffs", "dist_coeffs", "D1", "dist", "dist_coeff",
    "distortion_coeffs", "distortion",
)  # fmt: skip
_LIKE_DISTORTION = re.compile("dist|coef", re.IGNORECASE)  # in other names of it
_FISHEYE_FLAGS = ("fisheye", "fisheye_model")
_MODEL_KEYS = ("distortion_model", "camera_model", "model")
_FISHEYE_NAMES = ("equidistant", "fisheye", "equi", "kannala_brandt", "opencv_fisheye")
_RADIAL_NAMES = ("plumb_bob", "radtan", "rational_polynomial", "brown_conrady", "opencv", "pinhole")
_RADIAL_LENSES = {4: "opencv4", 5: "opencv5", 8: "opencv8", 12: "opencv12", 14: "opencv14"}
# Coefficients of a fisheye (k1 to k4), of omnidir and of the shortest radial lens (k1 k2 p1 p2).
_FOUR = 4
# Its presence makes the lens one of the module omnidir: xi, skew, k1 k2 p1 p2.
_XI_KEYS = ("xi",)
# Written beside OpenCV's own keys; OpenCV ignores it.
_FIELD_ANGLE_KEY = "valid_field_angle"


def has_camera_matrix(file: LensFile) -> bool:
    """Returns whether a key is one of the names that programs give the camera matrix."""
    if file.path.suffix.lower() == ".xml" and not is_opencv_xml(file):
        return False
    return LensValues(file.values, "").find(*_MATRIX_KEYS) is not None


def read_opencv(file: LensFile, camera_id: int | str | None) -> Camera:
    """Reads the camera of a FileStorage or camera_info file."""
    values = file.values
    reader = LensValues(values, file.source, file.text)
    matrix_key = reader.require(*_MATRIX_KEYS)
    matrix = reader.read_numbers(matrix_key, 9)
    if matrix_key == _OPEN3D_KEY and matrix[2:6:3] == [0.0, 0.0]:
        matrix = [matrix[3 * column + row] for row in range(3) for column in range(3)]
    is_omnidir = reader.find(*_XI_KEYS) is not None
    if (matrix[1] != 0.0 and not is_omnidir) or matrix[3:4] + matrix[6:] != [0.0, 0.0, 0.0, 1.0]:
        reader.fail(matrix_key, f"expected fx 0 cx, 0 fy cy, 0 0 1 (no skew), found {matrix}")
    params = [matrix[0], matrix[4], matrix[2] + FROM_ZERO, matrix[5] + FROM_ZERO]
    width, height = _read_size(reader)
    _refuse_part(reader)
    limit = reader.read_number(_FIELD_ANGLE_KEY) if _FIELD_ANGLE_KEY in values else None
    key = reader.find(*_DISTORTION_KEYS)
    other = [str(name) for name in values if _LIKE_DISTORTION.search(str(name))]
    other = [name for name in other if isinstance(values[name], (list, dict))]
    if key is None and other:
        reader.fail(other[0], f"is it the distortion? Then call it {_DISTORTION_KEYS[0]}")
    coefficients = reader.read_numbers(key) if key is not None else []
    keys, coefficients_of = 4 * [matrix_key], len(coefficients) * [str(key)]
    if is_omnidir:
        (xi,) = _read_list(reader, str(reader.find(*_XI_KEYS)), 1)
        if len(coefficients) != _FOUR:
            reader.fail(
                key or _DISTORTION_KEYS[0],
                f"omnidir has {_FOUR} coefficients, found {len(coefficients)}",
            )
        params += [matrix[1], xi, *coefficients]
        keys += [matrix_key, str(reader.find(*_XI_KEYS)), *coefficients_of]
        return reader.make_camera("mei", params, width, height, limit, keys)
    keys += coefficients_of
    fisheye = _is_fisheye(reader)
    if fisheye is None and len(coefficients) == _FOUR:
        reader.fail(
            str(key),
            "4 coefficients are k1 k2 p1 p2, or a fisheye's k1 to k4, and nothing says which: add "
            "'distortion_model: plumb_bob' or 'distortion_model: equidistant'",
        )
    if fisheye:
        if len(coefficients) != _FOUR:
            reader.fail(
                key or _DISTORTION_KEYS[0],
                f"a fisheye has {_FOUR} coefficients, found {len(coefficients)}",
            )
        return reader.make_camera(
            "kannala_brandt", params + coefficients, width, height, limit, keys
        )
    if not coefficients:
        return reader.make_camera("pinhole", params, width, height, limit, keys)
    lens = _RADIAL_LENSES.get(len(coefficients))
    if lens is None:
        known = ", ".join(map(str, _RADIAL_LENSES))
        reader.fail(str(key), f"expected {known} coefficients, found {len(coefficients)}")
    return reader.make_camera(lens, params + coefficients, width, height, limit, keys)


def _refuse_part(reader: LensValues) -> None:
    """Fails for what is of a part of the camera's pictures, of smaller ones, or of two cameras."""
    values = reader.values
    roi = values.get("roi")
    places = [roi.get(key) for key in ("x_offset", "y_offset")] if isinstance(roi, dict) else []
    is_part = any(place not in (None, 0) for place in places)
    sizes = [values.get(key) for key in ("binning_x", "binning_y")]
    if is_part or any(isinstance(size, int) and size > 1 for size in sizes):
        reader.fail(
            "roi" if is_part else "binning_x",
            "says that the pictures are a part of the camera's (roi), or smaller (binning): give "
            "the lens of these pictures, or remove the key where the pictures are whole",
        )
    if reader.find("M1") is not None and reader.find("M2") is not None:
        reader.fail("M2", "is a second camera: write M1, D1 and M2, D2 to a file each")


def _read_list(reader: LensValues, key: str, count: int) -> list[float]:
    """Reads the numbers of a list, of a matrix, or one plain number."""
    if isinstance(reader.values[key], (int, float, str)):
        return [reader.read_number(key)]
    return reader.read_numbers(key, count)


def _read_size(reader: LensValues) -> tuple[int, int]:
    both = reader.find("image_size", "imageSize", "img_size", "resolution", "size")
    if both is not None and reader.find("image_width", "width") is None:
        return reader.read_size(both)
    width_key = reader.require("image_width", "width", "imageWidth")
    height_key = reader.require("image_height", "height", "imageHeight")
    return reader.read_pixels(width_key), reader.read_pixels(height_key)


def _is_fisheye(reader: LensValues) -> bool | None:
    """Returns what the file says about it, or None if it says nothing that is known."""
    flag = reader.find(*_FISHEYE_FLAGS)
    if flag is not None:
        return str(reader.values[flag]).lower() not in ("0", "false", "no", "none")
    key = reader.find(*_MODEL_KEYS)
    name = None if key is None else str(reader.values[key]).lower()
    return True if name in _FISHEYE_NAMES else False if name in _RADIAL_NAMES else None


def to_opencv(camera: Camera) -> tuple[dict[str, int | float], list[float], list[float]]:
    """Returns plain keys, camera matrix and distortion coefficients of a camera."""
    if camera.model == "equirectangular":
        raise refuse_lens("OpenCV", camera)
    fx, fy, cx, cy, *coefficients = (float(value) for value in camera.params)
    skew, xi = 0.0, None
    if camera.model == "mei":
        skew, xi, *coefficients = coefficients
    fisheye = camera.model == "kannala_brandt"
    if fisheye and len(coefficients) <= _FOUR:
        coefficients += [0.0] * (_FOUR - len(coefficients))
    elif camera.model not in ("pinhole", "mei", *_RADIAL_LENSES.values()):
        raise refuse_lens("OpenCV", camera)
    plain: dict[str, int | float] = {
        "image_width": camera.width,
        "image_height": camera.height,
        "fisheye": int(fisheye),
    }
    if camera.valid_field_angle is not None:
        plain[_FIELD_ANGLE_KEY] = camera.valid_field_angle
    if xi is not None:
        plain["xi"] = xi
    matrix = [fx, skew, cx - FROM_ZERO, 0.0, fy, cy - FROM_ZERO, 0.0, 0.0, 1.0]
    return plain, matrix, coefficients


def format_opencv(camera: Camera, suffix: str) -> str:
    """Formats a FileStorage file, as JSON for the suffix .json, else as YAML."""
    import cv2  # here, because gsut --help needs none

    plain, matrix, coefficients = to_opencv(camera)
    is_json = suffix == ".json"
    kind = cv2.FILE_STORAGE_FORMAT_JSON if is_json else cv2.FILE_STORAGE_FORMAT_YAML
    flags = cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY | kind
    storage = cv2.FileStorage("", flags)
    for key, value in plain.items():
        storage.write(key, value)
    storage.write("camera_matrix", np.reshape(matrix, (3, 3)))
    if coefficients:
        storage.write("distortion_coefficients", np.reshape(coefficients, (1, -1)))
    return storage.releaseAndGetString()


FORMAT = LensFormat(
    "opencv",
    "OpenCV, ROS, Open3D",
    (*KEYED, ".xml"),
    read_opencv,
    has_camera_matrix,
    marks="camera_matrix",
    rank=40,
    write=format_opencv,
    names=("*.yaml", "*.yml", "*.json"),
)
