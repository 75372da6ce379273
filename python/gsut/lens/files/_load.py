"""Loads and saves lens files in whichever format a file has, or its name chooses."""

from __future__ import annotations

import fnmatch
import os
import re
from pathlib import Path

from gsut._core import CalibrationError, InputError
from gsut.bounds import name_wrong_kinds
from gsut.files import read_bytes, reading, register_reader, write_file
from gsut.lens.camera import Camera
from gsut.lens.files._format import (
    KEYED,
    LensFile,
    LensFormat,
    list_formats,
    make_lens_error,
)

_Path = str | os.PathLike[str]
_MOST_BYTES = 256 << 20  # of a lens file; tables of rays are the largest
_ADVICE = "is it a lens file, and whole?"
# Programs whose lens files are not read, by a key of these.
_FOREIGN = {
    "camera.fx": "ORB-SLAM", "camera1.fx": "ORB-SLAM", "model_type": "camodocal (VINS)",
    "value0": "Basalt", "ppx": "RealSense", "fisheye_params": "Gyroflow",
    "left_camera_matrix": "two cameras", "k2": "two cameras",
}  # fmt: skip
_WRITE_AGAIN = (
    "which is not read: write image_width, image_height, camera_matrix, distortion_coefficients "
    "and distortion_model (plumb_bob or equidistant) of the camera to a .yaml"
)


@register_reader("lens")
def load_camera(path: _Path, camera_id: int | str | None = None) -> Camera:
    """Reads a lens file.

    Formats, distinguished by name and content: mrcal .cameramodel, OpenCV YAML / JSON (FileStorage
    or ROS camera_info), Open3D's intrinsics JSON, Kalibr camchain YAML, EuRoC's sensor.yaml, COLMAP
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
    source, place = str(path), Path(path)
    file = LensFile(place, source, read_bytes(place, _MOST_BYTES))
    with reading(source, _ADVICE, make_lens_error):
        format = _find_format(file)
        if camera_id is not None and not format.has_ids:
            raise InputError(
                f"{source}: has no camera {camera_id}; it holds one lens without a name: leave "
                "camera_id out"
            )
        return format.read(file, camera_id)


def _find_format(file: LensFile) -> LensFormat:
    suffix = file.path.suffix.lower()
    candidates = [each for each in list_formats() if suffix in each.suffixes]
    found = next((each for each in candidates if each.has_marks(file)), None)
    if found is not None:
        return found
    keys = {str(key).lower() for key in file.values} if suffix in KEYED else set()
    for key, program in _FOREIGN.items():
        if key in keys:
            raise CalibrationError(f"{file.source}: a lens file of {program}, {_WRITE_AGAIN}")
    if candidates:
        marks = ", ".join(f"{each.marks} ({each.program})" for each in candidates)
        raise CalibrationError(f"{file.source}: holds none of {marks}; is it a lens file?")
    known = "; ".join(
        f"{kind} ({', '.join(each.program for each in list_formats() if kind in each.suffixes)})"
        for kind in list_suffixes()
    )
    raise InputError(f"{file.source}: unknown kind of lens file; known: {known}")


def list_suffixes() -> tuple[str, ...]:
    """Returns the suffixes of all files that `load_camera` reads."""
    return tuple(sorted({suffix for each in list_formats() for suffix in each.suffixes}))


@name_wrong_kinds
def save_camera(camera: Camera, path: _Path, format: str | None = None) -> None:
    """Writes a lens to a file that `load_camera` reads.

    The file is written under a temporary name and renamed, so that a crash leaves the old one.
    Kalibr and COLMAP files have no place for the valid field angle, and only mrcal's and gsut's
    have one for extrinsics and valid_region; those are left out.

    Args:
        camera: the lens.
        path: a file; its name chooses the format: *.cameramodel (mrcal), *camchain*.yaml (Kalibr),
            *.lens.json (gsut, which holds every lens), other *.yaml or *.yml and *.json (OpenCV),
            transforms*.json (nerfstudio), *.txt and *.bin (COLMAP).
        format: "mrcal", "gsut", "opencv", "kalibr", "nerfstudio", "colmap" or "colmap-binary", to
            choose it by hand.

    Raises:
        InputError: the format cannot hold this lens, or is unknown.
        InputError, also an OSError: the file cannot be written.
    """
    file = Path(path)
    chosen = _choose_format(file) if format is None else _find_by_name(format)
    assert chosen.write is not None
    write_file(file, chosen.write(camera, file.suffix.lower()))


def _choose_format(path: Path) -> LensFormat:
    """Returns the format with the most specific pattern that the file's name matches."""
    name, suffix = path.name.lower(), path.suffix.lower()
    for each in list_formats():
        if each.write is None and suffix in each.suffixes and each.name in re.split(r"\W|_", name):
            raise InputError(
                f"{path}: gsut reads lens files of {each.program} and writes none; use a name "
                f"without {each.name}, or give format"
            )
    matching = [
        ((len(pattern.rpartition("*")[2]), len(pattern)), each)
        for each in list_formats()
        for pattern in each.names
        if fnmatch.fnmatchcase(name, pattern)
    ]
    if not matching:
        known = ", ".join(pattern for each in list_formats() for pattern in each.names)
        raise InputError(f"{path}: the name chooses no format; use {known}, or give format")
    return max(matching, key=lambda row: row[0])[1]


def _find_by_name(name: str) -> LensFormat:
    known = {each.name: each for each in list_formats() if each.write is not None}
    if name not in known:
        raise InputError(f"unknown lens file format {name!r}; known: {', '.join(known)}")
    return known[name]
