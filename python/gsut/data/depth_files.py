"""Depth files of a dataset: distances along the pixels' rays."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gsut._core import InputError
from gsut.data.scene import Scene

MILLIMETRE = 1e-3  # what a level of a 16-bit depth picture is


def load_numbers(path: Path, what: str) -> np.ndarray:
    """The array of a .npy file that holds distances, or whatever `what` names.

    Raises:
        InputError: damaged, or no numbers.
    """
    try:
        return np.load(path, allow_pickle=False).astype(np.float64)
    except (ValueError, OSError, EOFError) as error:
        raise InputError(f"{path}: no array of {what}: {error}") from None


def read_depth(
    scene: Scene, view: int, path: Path | None = None, unit: float = MILLIMETRE
) -> np.ndarray | None:
    """(H, W) distances along the rays of a view, in the file's size.

    Args:
        scene: the dataset.
        view: number of the view.
        path: the file; None: the one that the dataset names.
        unit: world units of a level of 16-bit pictures; files .npy hold world units.

    Returns:
        The distances; None where there is no file.

    Raises:
        InputError: damaged, or of another size than the image was made or is used.
    """
    import cv2  # here, because gsut --help needs none

    path = scene.views[view].depth_path if path is None else path
    if path is None or not path.is_file():
        return None
    if path.suffix == ".npy":
        depth = load_numbers(path, "distances")
    else:
        picture = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        if picture is None or picture.ndim != 2:
            raise InputError(f"{path}: no depth picture of one channel")
        depth = picture * unit
    number = scene.views[view].camera_index
    sizes = [(c.height, c.width) for c in (scene.cameras[number], scene.file_cameras[number])]
    if depth.shape not in sizes:
        raise InputError(
            f"{path} is {' x '.join(map(str, depth.shape[::-1]))}, its image "
            f"{sizes[1][1]} x {sizes[1][0]}; give depths at the size of the images"
        )
    return depth
