"""Normal maps of a dataset: where the surface that a pixel shows faces, in the camera's frame."""

from __future__ import annotations

import numpy as np

from gsut._core import InputError
from gsut.data.depth_files import load_numbers
from gsut.data.scene import Scene

_SHORTEST = 0.5  # length of what is a normal; shorter ones are unknown


def read_normals(scene: Scene, view: int) -> np.ndarray | None:
    """(H, W, 3) float32 unit normals of a view, in the file's size; 0: not known.

    Axes are the camera's: x to the right, y down, z ahead. Files .npy hold the numbers, pictures of
    8 or 16 bits (n + 1) / 2 of their largest value, red x; as DN-Splatter has them.

    Args:
        scene: the dataset.
        view: number of the view.

    Returns:
        The normals; None where the dataset names no file.

    Raises:
        InputError: missing, damaged, or of another size than the image was made or is used.
    """
    import cv2  # here, because gsut --help needs none

    path = scene.views[view].normal_path
    if path is None:
        return None
    if path.suffix == ".npy":
        normals = load_numbers(path, "normals").astype(np.float32)
    else:
        picture = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        if picture is None or picture.ndim != 3 or picture.dtype not in (np.uint8, np.uint16):
            raise InputError(f"{path}: no picture of normals with three channels")
        largest = np.float32(255 if picture.dtype == np.uint8 else 65535)
        normals = picture[..., 2::-1].astype(np.float32) / (largest / 2) - 1
    number = scene.views[view].camera_index
    sizes = [(c.height, c.width) for c in (scene.cameras[number], scene.file_cameras[number])]
    if normals.shape[2:] != (3,) or normals.shape[:2] not in sizes:
        raise InputError(
            f"{path} is {' x '.join(map(str, normals.shape))}, its image {sizes[1][0]} rows of "
            f"{sizes[1][1]} pixels; give three numbers for each pixel of the image"
        )
    length = np.linalg.norm(normals, axis=2, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(length > _SHORTEST, normals / length, 0.0).astype(np.float32)
