"""Reads a view's depth files."""

from __future__ import annotations

import concurrent.futures
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.data.scene.depth_form import DISTANCES
from gsut.data.scene.scene import Scene
from gsut.files import Array, read_npy, read_picture, register_reader

HALF_PIXEL = 0.5  # sides of smaller copies are rounded by this much


def read_depth(scene: Scene, view: int, path: Path | None = None) -> np.ndarray | None:
    """Reads the distances along the rays of a view.

    Args:
        scene: the dataset.
        view: index of the view.
        path: a file of distances, whole levels are thousandths; None: the one that the
            dataset names, in the form that it states.

    Returns:
        (H, W) distances at the file's size, NaN where the sensor is not sure; None where there is
        no file.

    Raises:
        InputError: damaged, or of another shape than the image.
    """
    form = scene.views[view].depth_form if path is None else DISTANCES
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
        if picture is None or picture.ndim != 2 or picture.dtype == np.uint8:
            raise InputError(
                f"{path}: no depth picture of one channel with 16 bits or floating-point numbers"
            )
        depth = picture * (1.0 if picture.dtype.kind == "f" else form.unit)
    camera = scene.file_cameras[scene.views[view].camera_index]
    height, width = camera.height, camera.width
    if depth.ndim != 2 or abs(depth.shape[0] - height * depth.shape[1] / width) > HALF_PIXEL:
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


def has_depths(scene: Scene) -> bool:
    """Returns whether training views have depth files."""
    return any(scene.views[i].depth_path is not None for i in scene.train_indices)


def find_bad_depths(scene: Scene) -> Iterator[InputError]:
    """Reads the depth files of all views; yields why one cannot be used."""

    def read(view: int) -> InputError | None:
        try:
            read_depth(scene, view)
        except InputError as error:
            return error
        return None

    with concurrent.futures.ThreadPoolExecutor(_core.num_threads()) as threads:
        yield from filter(None, threads.map(read, range(len(scene.views))))


@register_reader("depths", ".npy")
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
