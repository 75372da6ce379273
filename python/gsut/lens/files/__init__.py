"""Lens files in and out: finds the format; one file a format beside this one."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from gsut import _core
from gsut._core import CalibrationError, InputError
from gsut.files import parse_yaml, reading, regular, write_file
from gsut.lens.camera import Camera
from gsut.lens.files.aria import format_aria, is_aria, load_aria
from gsut.lens.files.colmap import (
    colmap_camera,
    format_colmap,
    format_colmap_binary,
    load_colmap_binary,
    load_colmap_text,
)
from gsut.lens.files.euroc import is_euroc, load_euroc
from gsut.lens.files.kalibr import format_kalibr, is_camchain, load_kalibr
from gsut.lens.files.matlab import format_matlab, is_matlab, load_matlab
from gsut.lens.files.metashape import format_metashape, load_metashape
from gsut.lens.files.nerfstudio import (
    format_nerfstudio,
    is_nerfstudio,
    load_nerfstudio,
    nerfstudio_camera,
)
from gsut.lens.files.ocam import format_ocam, is_ocam_text, load_ocam
from gsut.lens.files.opencv import (
    format_opencv_json,
    format_opencv_yaml,
    has_camera_matrix,
    load_opencv,
)
from gsut.lens.files.opensfm import format_opensfm, is_opensfm, load_opensfm
from gsut.lens.files.own import camera_from_values, format_own, is_own
from gsut.lens.files.table import is_table, load_table
from gsut.lens.files.values import LensValues

__all__ = ["colmap_camera", "load_camera", "nerfstudio_camera", "save_camera"]

_Path = str | os.PathLike[str]
_YAML = (".yaml", ".yml")
LENS_SUFFIXES = (".bin", ".cameramodel", ".csv", ".json", ".npz", ".txt", ".xml", *_YAML)
# What in the name of a .json chooses its format; OpenCV's else.
_JSON_WORDS = {"aria": "aria", "matlab": "matlab", "opensfm": "camera_models"}
OWN_SUFFIX = ".lens.json"  # of gsut's own form, which holds every lens


def load_camera(path: _Path, camera_id: int | str | None = None) -> Camera:
    """Reads a lens file.

    Formats, told apart by name and content: mrcal .cameramodel, OpenCV YAML / JSON (FileStorage or
    ROS camera_info), Open3D's intrinsics JSON, Kalibr camchain YAML, EuRoC's sensor.yaml, COLMAP
    cameras.txt and cameras.bin, nerfstudio transforms.json, Project Aria calibration JSON,
    OCamCalib's calib_results.txt, MATLAB's intrinsics as JSON (jsonencode(toStruct(intrinsics))),
    Metashape's calibration XML, OpenSfM's camera_models.json, gsut's own .lens.json, and tables of
    pixels and rays (.csv of x, y, rx, ry, rz; .npz), to which the nearest of the usual models is
    fitted. Pixel conventions are converted: the centre of the top-left pixel is (0.5, 0.5) for
    gsut, COLMAP, nerfstudio and Metashape, (1, 1) for MATLAB, and (0, 0) for the others.

    Args:
        path: the file.
        camera_id: which camera, for a file with several: COLMAP's number, Kalibr's "cam0", the
            label of Aria or Metashape, the name of OpenSfM.

    Returns:
        The camera. The valid field angle is set where the file states one.

    Raises:
        CalibrationError: the file is not a lens file, is cut off, lacks a key, or holds a lens that
            gsut does not have; the message names file, line where known, and key.
        InputError: the file holds several cameras and camera_id is not given or not among them.
        OSError: the file cannot be read.
    """
    source = str(path)
    with reading(lambda what: CalibrationError(f"{source}: {what}; is it a lens file, and whole?")):
        return _load(Path(path), source, camera_id)


def _load(file: Path, source: str, camera_id: int | str | None) -> Camera:
    data = regular(file).read_bytes()
    suffix = file.suffix.lower()
    if suffix == ".bin":
        return load_colmap_binary(data, source, camera_id)
    if is_table(suffix):
        return load_table(data, source)
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise CalibrationError(f"{source}: is not text ({error}); give a lens file") from error
    if suffix == ".txt":
        if is_ocam_text(text):
            return load_ocam(text, source)
        return load_colmap_text(text, source, camera_id)
    if suffix == ".xml":
        return load_metashape(text, source, camera_id)
    if suffix == ".cameramodel":
        return _load_mrcal(text, source)
    if suffix == ".json":
        return _load_keys(_parse_json(text, source), source, text, camera_id)
    if suffix in _YAML:
        return _load_keys(_parse_yaml(text, source), source, text, camera_id)
    raise InputError(
        f"{source}: unknown kind of lens file; known: .cameramodel (mrcal), .yaml, .yml and .json"
        " (gsut, OpenCV, ROS, Kalibr, EuRoC, nerfstudio, Project Aria, OpenSfM, MATLAB),"
        " cameras.txt and cameras.bin (COLMAP), calib_results.txt (OCamCalib), .xml (Metashape),"
        " .csv and .npz (pixels and rays)"
    )


def _load_mrcal(text: str, source: str) -> Camera:
    core, extrinsics, valid_region = _core.parse_camera_model(text, source)
    try:
        return Camera(
            core.model,
            core.params,
            core.width,
            core.height,
            valid_field_angle=core.valid_field_angle,
            extrinsics=extrinsics,
            # No polygon is unknown; an empty one means that mrcal trusts no pixel.
            valid_region=None if valid_region is None else np.reshape(valid_region, (-1, 2)),
        )
    except InputError as error:
        LensValues({}, source, text).fail("intrinsics", str(error))


def _load_keys(values: Any, source: str, text: str, camera_id: int | str | None) -> Camera:
    if not isinstance(values, dict):
        raise CalibrationError(
            f"{source}: expected keys with values, found {type(values).__name__}"
        )
    if is_aria(values):
        return load_aria(values, source, text, camera_id)
    if is_camchain(values):
        return load_kalibr(values, source, text, camera_id)
    if is_euroc(values):
        return load_euroc(values, source, text)
    if has_camera_matrix(values):
        return load_opencv(values, source, text)
    if is_matlab(values):
        return load_matlab(values, source, text)
    if is_opensfm(values):
        return load_opensfm(values, source, text, camera_id)
    if is_own(values):
        return camera_from_values(values, source, text)
    if is_nerfstudio(values):
        return load_nerfstudio(values, source, text)
    raise CalibrationError(
        f"{source}: has neither camera_matrix (OpenCV) nor model and params (gsut) nor cam0"
        " (Kalibr) nor fl_x (nerfstudio) nor cameras (Project Aria) nor projection_type (OpenSfM)"
        " nor ImageSize (MATLAB); is it a lens file?"
    )


def _parse_json(text: str, source: str) -> Any:
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        raise CalibrationError(
            f"{source}, line {error.lineno}: not JSON ({error.msg}); is the file cut off?"
        ) from error


def _parse_yaml(text: str, source: str) -> Any:
    return parse_yaml(text, lambda at, what: CalibrationError(f"{source}{at}: not YAML ({what})"))


def _format_mrcal(camera: Camera) -> str:
    extrinsics = [0.0] * 6 if camera.extrinsics is None else list(camera.extrinsics)
    region = None if camera.valid_region is None else camera.valid_region.tolist()
    return _core.format_camera_model(camera, extrinsics, region)


def _format_opencv(camera: Camera, path: Path) -> str:
    return (format_opencv_json if path.suffix.lower() == ".json" else format_opencv_yaml)(camera)


_WRITERS: dict[str, Callable[[Camera, Path], str | bytes]] = {
    "mrcal": lambda camera, _: _format_mrcal(camera),
    "opencv": _format_opencv,
    "kalibr": lambda camera, _: format_kalibr(camera),
    "nerfstudio": lambda camera, _: format_nerfstudio(camera),
    "colmap": lambda camera, _: format_colmap(camera),
    "colmap-binary": lambda camera, _: format_colmap_binary(camera),
    "aria": lambda camera, _: format_aria(camera),
    "gsut": lambda camera, _: format_own(camera),
    "matlab": lambda camera, _: format_matlab(camera),
    "metashape": lambda camera, _: format_metashape(camera),
    "ocam": lambda camera, _: format_ocam(camera),
    "opensfm": lambda camera, _: format_opensfm(camera),
}


def _format_of_name(path: Path) -> str:
    name, suffix = path.name.lower(), path.suffix.lower()
    if suffix == ".cameramodel":
        return "mrcal"
    if suffix == ".txt":
        return "ocam" if "calib_results" in name else "colmap"
    if suffix == ".xml":
        return "metashape"
    if suffix == ".json":
        if name.endswith(OWN_SUFFIX):
            return "gsut"
        if name.startswith("transforms"):
            return "nerfstudio"
        return next((kind for kind in _JSON_WORDS if _JSON_WORDS[kind] in name), "opencv")
    if suffix == ".bin":
        return "colmap-binary"
    if suffix in _YAML:
        return "kalibr" if "camchain" in name else "opencv"
    raise InputError(
        f"{path}: the name chooses no format; use .cameramodel, .yaml, .json, .txt, .bin or .xml,"
        " or give format"
    )


def save_camera(camera: Camera, path: _Path, format: str | None = None) -> None:
    """See `gsut.Camera.save`."""
    file = Path(path)
    chosen = _format_of_name(file) if format is None else format
    if chosen not in _WRITERS:
        raise InputError(f"unknown lens file format {format!r}; known: {', '.join(_WRITERS)}")
    write_file(file, _WRITERS[chosen](camera, file))
