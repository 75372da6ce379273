"""Reads a view's depth and normal files."""

from __future__ import annotations

import concurrent.futures
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.data.scene.depth_form import MILLIMETRE, DepthForm
from gsut.data.scene.scene import Scene
from gsut.files import Array, read_npy, read_picture, register_reader

_HALF_PIXEL = 0.5  # the height of smaller depths of the same shape is rounded by this much
_SHORTEST = 0.5  # length from which three numbers are a normal; shorter ones mean unknown


def read_depth(
    scene: Scene, view: int, path: Path | None = None, unit: float = MILLIMETRE
) -> np.ndarray | None:
    """Reads the distances along the rays of a view.

    Args:
        scene: the dataset.
        view: index of the view.
        path: the file; None: the one that the dataset names, in the form that it states.
        unit: of `path`: world units of a level of 16-bit pictures.

    Returns:
        (H, W) distances at the file's size, NaN where the sensor is not sure; None where there is
        no file.

    Raises:
        InputError: damaged, or of another shape than the image.
    """
    form = scene.views[view].depth_form if path is None else DepthForm(unit)
    path = scene.views[view].depth_path if path is None else path
    if path is None or not path.is_file():
        return None
    if path.suffix == ".npy":
        depth = _load_numbers(path)
    else:
        picture = _load_picture(path)
        if picture is None and path.suffix == ".exr":
            _require_exr(path)
        if picture is not None and picture.ndim == 3 and path.suffix == ".exr":
            picture = picture[..., 2]  # red, where there is one channel alone
        if picture is None or picture.ndim != 2:
            raise InputError(f"{path}: no depth picture of one channel")
        depth = picture * (1.0 if path.suffix == ".exr" else form.unit)
    height, width = _list_image_sizes(scene, view)[1]
    if depth.ndim != 2 or abs(depth.shape[0] - height * depth.shape[1] / width) > _HALF_PIXEL:
        raise InputError(
            f"{path} is {' x '.join(map(str, depth.shape[::-1]))}, its image {width} x {height}; "
            "give depths of the whole image, at any size"
        )
    if form.is_z:
        rays = np.asarray(scene.camera(view).resize(*depth.shape[::-1]).rays()[0])
        with np.errstate(invalid="ignore", divide="ignore"):
            depth = depth * (np.linalg.norm(rays, axis=2) / rays[..., 2])
    if form.confidence_path is not None:
        sure = _load_picture(form.confidence_path)
        if sure is None or sure.shape != depth.shape:
            raise InputError(f"{form.confidence_path}: no picture of the size of {path}")
        depth = np.where(sure >= form.least_confidence, depth, np.nan)
    return depth


def read_normals(scene: Scene, view: int) -> np.ndarray | None:
    """Reads the normals of the surface that each pixel of a view shows.

    Axes are the camera's: x right, y down, z forward. A .npy file holds the numbers, a picture of 8
    or 16 bits (n + 1) / 2 of its largest value with x in red, as DN-Splatter writes it.

    Args:
        scene: the dataset.
        view: index of the view.

    Returns:
        (H, W, 3) float32 unit normals at the file's size, 0 where unknown; None where the dataset
        names no file.

    Raises:
        InputError: missing, damaged, or neither of the image's size in its file nor of that in the
            scene.
    """
    path = scene.views[view].normal_path
    if path is None:
        return None
    if path.suffix == ".npy":
        normals = _load_numbers(path).astype(np.float32)
    else:
        picture = _load_picture(path)
        if picture is None or picture.ndim != 3 or picture.dtype not in (np.uint8, np.uint16):
            raise InputError(f"{path}: no picture of normals with three channels")
        largest = np.float32(255 if picture.dtype == np.uint8 else 65535)
        normals = picture[..., 2::-1].astype(np.float32) / (largest / 2) - 1
    sizes = _list_image_sizes(scene, view)
    if normals.shape[2:] != (3,) or normals.shape[:2] not in sizes:
        raise InputError(
            f"{path} is {' x '.join(map(str, normals.shape))}, its image {sizes[1][0]} rows of "
            f"{sizes[1][1]} pixels; give three numbers for each pixel of the image"
        )
    length = np.linalg.norm(normals, axis=2, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(length > _SHORTEST, normals / length, 0.0).astype(np.float32)


def find_bad_maps(scene: Scene, depth: bool = True, normals: bool = True) -> Iterator[InputError]:
    """Reads the depth and normal files of all views; yields why one cannot be used."""

    def read(view: int) -> list[InputError]:
        errors = []
        for each in (read_depth,) * depth + (read_normals,) * normals:
            try:
                each(scene, view)
            except InputError as error:
                errors.append(error)
        return errors

    with concurrent.futures.ThreadPoolExecutor(_core.num_threads()) as threads:
        for errors in threads.map(read, range(len(scene.views))):
            yield from errors


@register_reader("depths and normals", ".npy")
def _load_numbers(path: Path) -> np.ndarray:
    return read_npy(path, Array(finite=False)).astype(np.float64)


def _require_exr(path: Path) -> None:
    """Raises InputError if the installed OpenCV has no OpenEXR, as wheels of OpenCV 5 have none."""
    import cv2

    if not cv2.haveImageWriter(path.name):
        raise InputError(
            f"{path}: OpenCV {cv2.__version__} reads no .exr here; "
            "pip install 'opencv-contrib-python-headless<5'"
        )


def _load_picture(path: Path) -> np.ndarray | None:
    import cv2  # here, because gsut --help needs none

    return read_picture(path, cv2.IMREAD_UNCHANGED)


def _list_image_sizes(scene: Scene, view: int) -> list[tuple[int, int]]:
    """Returns (height, width) of a view's image in the scene and in its file."""
    number = scene.views[view].camera_index
    cameras = (scene.cameras[number], scene.file_cameras[number])
    return [(camera.height, camera.width) for camera in cameras]
