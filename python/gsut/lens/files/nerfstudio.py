"""Intrinsics in nerfstudio's transforms.json."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from gsut._core import CalibrationError, InputError
from gsut.lens.camera import Camera
from gsut.lens.files._format import KEYED, LensFile, LensFormat
from gsut.lens.files._load import load_camera
from gsut.lens.files._values import LensValues, refuse_lens

_DISTORTION_KEYS = ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2")
LENS_FILE = "lens_file"  # gsut's own key: a lens file beside the transforms.json
LENS_ID = "lens_id"  # gsut's own key: which of that file's lenses it is
_SIZE_KEYS = ("w", "h")
_INTRINSIC_KEYS = (
    "camera_model",
    "is_fisheye",
    "fl_x",
    "fl_y",
    "cx",
    "cy",
    "camera_angle_x",
    "camera_angle_y",
    "max_theta_rad",
    "distortion_params",
    *_DISTORTION_KEYS,
)
_LENS_KEYS = (*_SIZE_KEYS, LENS_FILE, LENS_ID, *_INTRINSIC_KEYS)
_PERSPECTIVE = ("OPENCV", "SIMPLE_RADIAL", "RADIAL")
_FISHEYE = ("OPENCV_FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE")
_PINHOLE = ("PINHOLE", "SIMPLE_PINHOLE", "PERSPECTIVE")
_KNOWN = (*_PINHOLE, *_PERSPECTIVE, "FULL_OPENCV", *_FISHEYE, "FISHEYE624", "EQUIRECTANGULAR")
_SUPPORTED = ", ".join(_KNOWN)
# gsut's lens: the name that is written, and the keys of its coefficients.
_LENSES: dict[str, tuple[str, tuple[str, ...]]] = {
    "pinhole": ("PINHOLE", ()),
    "opencv4": ("OPENCV", ("k1", "k2", "p1", "p2")),
    "opencv5": ("OPENCV", ("k1", "k2", "p1", "p2", "k3")),
    "opencv8": ("FULL_OPENCV", ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")),
    "kannala_brandt": ("OPENCV_FISHEYE", ("k1", "k2", "k3", "k4")),
}
_FISHEYE624_KEY = "distortion_params"  # k0 to k5, p0, p1, s0 to s3 under one key
_NUM_FISHEYE624 = 12  # numbers under that key


def is_nerfstudio(file: LensFile) -> bool:
    """Returns whether any key is one of a transforms.json."""
    return any(
        key in file.values
        for key in ("fl_x", "camera_angle_x", "frames", "camera_model", LENS_FILE)
    )


def merge_frame_lens(
    values: dict[str, Any], frame: dict[str, Any], source: str = "", text: str = ""
) -> dict[str, Any]:
    """Returns the keys of a frame's lens in a transforms.json, for `camera_from_nerfstudio`.

    A frame's own keys win over the file's. A frame's lens_file hides the file's intrinsics, and a
    frame's intrinsics hide the file's lens_file.

    Args:
        values: the file's top level.
        frame: the frame's keys; empty for the file's own lens.

    Raises:
        CalibrationError: a lens_file stands beside intrinsics.
    """
    levels = []
    for level, where in ((values, source), (frame, _name_frame(frame, source))):
        keys = {key: level[key] for key in _LENS_KEYS if key in level}
        intrinsics = [key for key in keys if key in _INTRINSIC_KEYS]
        if LENS_FILE in keys and intrinsics:
            LensValues(level, where, text).fail(
                LENS_FILE, f"stands beside {intrinsics[0]}, which it replaces; keep one of them"
            )
        levels.append(keys)
    whole, own = levels
    if LENS_FILE in own:
        whole = {key: whole[key] for key in _SIZE_KEYS if key in whole}
    elif any(key in _INTRINSIC_KEYS for key in own):
        whole = {key: whole[key] for key in whole if key not in (LENS_FILE, LENS_ID)}
    return {**whole, **own}


def _name_frame(frame: dict[str, Any], source: str) -> str:
    return f"{source}, frame {frame['file_path']}" if "file_path" in frame else source


def _load_lens_file(reader: LensValues, folder: Path) -> Camera:
    """Loads the file that `lens_file` names, and compares its size with w and h if given."""
    name = reader.values[LENS_FILE]
    if not isinstance(name, str) or not (folder / name).is_file():
        reader.fail(
            LENS_FILE, f"'{name}' does not exist under {folder}; add it or correct the path"
        )
    try:
        camera = load_camera(folder / name, reader.values.get(LENS_ID))
    except InputError as error:
        place = f"{reader.source}, {LENS_FILE}" if reader.source else LENS_FILE
        advice = (
            f" ('{LENS_ID}' beside '{LENS_FILE}' says which)" if "camera_id" in str(error) else ""
        )
        raise CalibrationError(f"{place}: {error}{advice}") from error
    for key, found in zip(_SIZE_KEYS, (camera.width, camera.height), strict=True):
        if key in reader.values and reader.read_pixels(key) != found:
            reader.fail(key, f"is {reader.read_pixels(key)}, and the lens of {name} is for {found}")
    return camera


def camera_from_nerfstudio(
    values: dict[str, Any], source: str = "", text: str = "", folder: Path | None = None
) -> Camera:
    """Makes the camera of one frame of a transforms.json.

    Args:
        values: of `merge_frame_lens`. lens_file, gsut's own key: a path beside the file to any lens
            file that `load_camera` reads (lens_id: which of its cameras). Else camera_model
            (absent: OPENCV_FISHEYE if is_fisheye, else OPENCV with distortion, else PINHOLE);
            w, h in pixels; fl_x, fl_y in pixels, or camera_angle_x, camera_angle_y, the full field
            of view in radians (either defaults to the other); cx, cy (default: the centre) in
            gsut's pixel convention; k1.. p1 p2; max_theta_rad, the valid field angle in radians.
        source: the file's name, for messages.
        text: the file's text, to name lines in messages.
        folder: that lens_file is looked for in; None: that of `source`.

    Returns:
        The camera of the lens file, or `pinhole`; OPENCV is `opencv4`, or `opencv5` if k3 is not 0;
        FULL_OPENCV is `opencv8`; the fisheyes are `kannala_brandt`; FISHEYE624 (with
        distortion_params, 12 numbers) and EQUIRECTANGULAR (w and h only) are the lenses of these
        names.

    Raises:
        CalibrationError: a key is missing or no finite number, or the model is not supported.
    """
    reader = LensValues(values, source, text)
    if LENS_FILE in values:
        return _load_lens_file(reader, Path(source).parent if folder is None else folder)
    width, height = reader.read_pixels("w"), reader.read_pixels("h")
    limit = reader.read_number("max_theta_rad") if values.get("max_theta_rad") is not None else None
    if _find_model_name(reader) == "EQUIRECTANGULAR":  # files give focal lengths that mean nothing
        return reader.make_camera("equirectangular", [], width, height, limit)
    # Square pixels unless the file says otherwise.
    axes = [("fl_x", "camera_angle_x", width), ("fl_y", "camera_angle_y", height)]
    given_axes = [axis for axis in axes if any(values.get(key) is not None for key in axis[:2])]
    axes = axes if len(given_axes) == 2 else 2 * (given_axes or axes)[:1]
    params = [_read_focal(reader, *axis) for axis in axes]
    params += [reader.read_number("cx", width / 2), reader.read_number("cy", height / 2)]
    keys = [*(_choose_focal_key(reader, *axis[:2]) for axis in axes), "cx", "cy"]
    given = {key: reader.read_number(key, 0.0) for key in _DISTORTION_KEYS}
    model = _find_model_name(reader)
    if model == "FISHEYE624":
        params += reader.read_numbers(reader.require(_FISHEYE624_KEY), _NUM_FISHEYE624)
        keys += _NUM_FISHEYE624 * [_FISHEYE624_KEY]
        return reader.make_camera("fisheye624", params, width, height, limit, keys)
    if model in _PINHOLE:
        lens = "pinhole"
        if any(given.values()):
            reader.fail("camera_model", f"is {model}, yet the file gives distortion; use OPENCV")
    elif model in _PERSPECTIVE:
        lens = "opencv5" if given["k3"] else "opencv4"
        if given["k4"] or given["k5"] or given["k6"]:
            reader.fail(
                "k4",
                "means r^8 to nerfstudio and the denominator to OpenCV; set k4 to k6 to 0, or"
                " camera_model to FULL_OPENCV for OpenCV's meaning",
            )
    elif model == "FULL_OPENCV":
        lens = "opencv8"
    else:
        lens = "kannala_brandt"
        for key in ("k5", "k6", "p1", "p2"):
            if given[key]:
                reader.fail(
                    key, f"is {given[key]:g}, but {model} has k1 to k4 only: name the model OPENCV "
                    "for p1, p2",
                )  # fmt: skip
    own = _LENSES[lens][1]
    params += [given[key] for key in own]
    return reader.make_camera(lens, params, width, height, limit, [*keys, *own])


def _find_model_name(reader: LensValues) -> str:
    model = reader.values.get("camera_model")
    if model is None:
        if reader.values.get("is_fisheye"):
            return "OPENCV_FISHEYE"
        distorted = any(reader.values.get(key) for key in _DISTORTION_KEYS)
        return "OPENCV" if distorted else "PINHOLE"
    if str(model).upper() not in _KNOWN:
        reader.fail("camera_model", f"{model!r} is not supported; supported: {_SUPPORTED}")
    return str(model).upper()


def _choose_focal_key(reader: LensValues, key: str, angle_key: str) -> str:
    return key if reader.values.get(key) is not None else angle_key


def _read_focal(reader: LensValues, key: str, angle_key: str, size: int) -> float:
    if reader.values.get(key) is not None:
        return reader.read_number(key)
    if reader.values.get(angle_key) is None:
        reader.fail(key, f"is missing (and so is {angle_key}); add the focal length in pixels")
    angle = reader.read_number(angle_key)
    if not 0.0 < angle < math.pi:
        degrees = f" (degrees? write {math.radians(angle):.6g})" if math.pi < angle < 360 else ""
        reader.fail(angle_key, f"expected radians between 0 and pi, found {angle:g}{degrees}")
    return 0.5 * size / math.tan(0.5 * angle)


def read_nerfstudio(file: LensFile, camera_id: int | str | None) -> Camera:
    """Reads the one camera that all frames of a transforms.json share."""
    values, source, text = file.values, file.source, file.text
    frames = values.get("frames")
    cameras: list[Camera] = []
    for frame in frames if isinstance(frames, list) else []:
        if isinstance(frame, dict) and any(key in frame for key in _LENS_KEYS):
            camera = camera_from_nerfstudio(
                merge_frame_lens(values, frame, source, text), source, text
            )
            cameras += [] if camera in cameras else [camera]
    if len(cameras) > 1:
        raise InputError(
            f"{source}: its frames have {len(cameras)} different cameras; load it as a data set"
        )
    if cameras:
        return cameras[0]
    return camera_from_nerfstudio(merge_frame_lens(values, {}, source, text), source, text)


def format_nerfstudio(camera: Camera) -> str:
    """Formats a transforms.json that holds this camera and no frames."""
    name, keys = _LENSES.get(camera.model, ("", ()))
    coefficients = [float(value) for value in camera.params[4:]]
    values: dict[str, Any] = {"camera_model": name, "w": camera.width, "h": camera.height}
    if camera.valid_field_angle is not None:
        values["max_theta_rad"] = camera.valid_field_angle
    if camera.model == "equirectangular":
        values["camera_model"] = "EQUIRECTANGULAR"
        # Without meaning for a panorama, but nerfstudio divides by them.
        w, h = camera.width, camera.height
        values |= {"fl_x": w / 2, "fl_y": float(h), "cx": w / 2, "cy": h / 2}
        return json.dumps(values, indent=2) + "\n"
    if camera.model == "fisheye624":
        values["camera_model"] = name = "FISHEYE624"
        values[_FISHEYE624_KEY], coefficients = coefficients, []
    if not name or len(coefficients) > len(keys):
        raise refuse_lens("nerfstudio", camera)
    coefficients += [0.0] * (len(keys) - len(coefficients))
    values.update(zip(("fl_x", "fl_y", "cx", "cy"), map(float, camera.params[:4]), strict=True))
    values.update(zip(keys, coefficients, strict=True))
    return json.dumps(values, indent=2) + "\n"


FORMAT = LensFormat(
    "nerfstudio",
    "nerfstudio",
    KEYED,
    read_nerfstudio,
    is_nerfstudio,
    marks="fl_x",
    rank=80,
    write=lambda camera, suffix: format_nerfstudio(camera),
    names=("transforms*.json",),
)
