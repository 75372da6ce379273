"""Writes the demo's scenes, which come with the package, as data sets.

Their pictures were ray-cast by lab/demo_tracer, which can make the files beside this module again.
"""

from __future__ import annotations

import os
from pathlib import Path

import cv2

from gsut._core import InputError
from gsut.files import copy_file, read_picture, whole_folder, write_picture

DEMO_SCENES = ("fisheye_hall", "rig_hall")
_PICTURES = (".png", ".webp")


def write_demo_scene(folder: str | os.PathLike[str], name: str = "fisheye_hall") -> Path:
    """Writes a small nerfstudio data set with exact truth: a furnished hall through fisheyes.

    `fisheye_hall` has 30 training and 5 test images of 200 x 200 pixels through a 190-degree lens:
    transforms.json (OPENCV_FISHEYE, camera-to-world with OpenGL axes, metres, pixel centre 0.5),
    images/*.png, mask.png (255 where a pixel lies wholly inside the image circle), points3D.ply
    (4000 surface points, off by 1 cm), depth/*.png of the test images (distance along the ray in
    mm, 16 bit, 0 outside the circle) and labels/*.png (8 bit: the number of the surface, 255
    outside the circle; for `gsut lift`).

    `rig_hall` has the images of two fisheyes on one body, images/left/*.png and images/right/*.png
    (same file name: same moment) with a mask.png each, the lens files left.yaml and right.yaml,
    rig.json (camera_from_reference in metres, as `gsut calibrate --rig` writes it), and as truth
    transforms.json and depth/left/*.png and depth/right/*.png of every eighth image.

    Args:
        folder: is created; appears only when it is complete.
        name: one of `DEMO_SCENES`.

    Returns:
        The folder.

    Raises:
        InputError: the folder exists or cannot be created, or there is no scene of this name.
    """
    if name not in DEMO_SCENES:
        raise InputError(f"no demo scene is named {name!r}; give one of {', '.join(DEMO_SCENES)}")
    folder, source = Path(folder), Path(__file__).parent / name
    with whole_folder(folder) as partial:
        for file in sorted(source.rglob("*")):
            copy = partial / file.relative_to(source)
            if file.is_dir():
                copy.mkdir()
            elif file.suffix in _PICTURES:
                picture = read_picture(file, cv2.IMREAD_UNCHANGED)
                write_picture(copy.with_suffix(".png"), picture)
            else:
                copy_file(file, copy)
    return folder
