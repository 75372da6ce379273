"""The demo's hall seen by two cameras on one body, with the truth: for `gsut poses --rig`."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path

import numpy as np

from gsut._core import InputError, exp_pose
from gsut.data import Frame, inverse, write_transforms
from gsut.demo.dataset import render_views, whole_pixels, write_image
from gsut.demo.hall import make_hall
from gsut.demo.views import camera_path, demo_camera
from gsut.files import whole_folder
from gsut.lens import Camera

CAMERAS = ("left", "right")
# The right camera: its lens in image sizes, Kannala-Brandt, seen to 80 degrees.
_FOCAL = (0.3315, 0.3309)
_CENTRE = (0.4952, 0.5041)
_DISTORTION = (-0.012, 0.004, -0.002, 0.0003)
_MAX_ANGLE = math.radians(80.0)
# Its place on the body, the left camera's frame: metres, and a turn (rotation vector, radians).
_PLACE = (0.24, 0.01, -0.02)
_TURN = (0.03, 0.12, -0.02)


def right_camera(size: int) -> Camera:
    """The second lens, for square images of this many pixels a side."""
    params = [size * value for value in (*_FOCAL, *_CENTRE)] + list(_DISTORTION)
    return Camera("kannala_brandt", params, size, size, valid_field_angle=_MAX_ANGLE)


def right_from_left() -> np.ndarray:
    """(4, 4) of the demo's rig, metres."""
    pose = exp_pose([0.0, 0.0, 0.0, *_TURN])
    pose[:3, 3] = -pose[:3, :3] @ np.array(_PLACE)
    return pose


def make_demo_rig(
    folder: str | os.PathLike[str],
    frames: int = 20,
    size: int = 240,
    seed: int = 0,
    progress: bool = True,
    path_share: float = 1.0,
) -> Path:
    """Makes a small data set of a rig with exact truth: two fisheyes on one body in a hall.

    Writes images/left/*.png and images/right/*.png (the same name: the same frame) with a mask.png
    each, left.yaml and right.yaml (OpenCV), rig.json (as `gsut calibrate --rig` writes its
    report.json: lenses and camera_from_reference, metres) and, as truth, transforms.json.

    Args:
        folder: is created; appears only when it is complete.
        frames: number of images of each camera.
        size: width and height of the images, pixels.
        seed: of textures and path; the same seed gives the same bytes.
        progress: show a progress bar on stderr.
        path_share: of the demo's path, above 0 and up to 1, that the rig goes.

    Returns:
        The folder.

    Raises:
        InputError: the folder exists or cannot be created, or a number is out of range.
    """
    folder = Path(folder)
    for name, value, least in (("frames", frames, 2), ("size", size, 16), ("seed", seed, 0)):
        if value < least:
            raise InputError(f"{name} is {value}; give at least {least}")
    if not 0.0 < path_share <= 1.0:
        raise InputError(f"path_share is {path_share}; give more than 0 and at most 1")
    path = camera_path(round(frames / path_share), seed)[:frames]
    with whole_folder(folder) as partial:
        _write(partial, path, size, seed, progress)
    return folder


def _write(folder: Path, path: list[np.ndarray], size: int, seed: int, progress: bool) -> None:
    hall = make_hall(seed)
    frames, cameras = [], {}
    for name, lens, camera_from_left in zip(
        CAMERAS,
        (demo_camera(size), right_camera(size)),
        (np.eye(4), right_from_left()),
        strict=True,
    ):
        images = folder / "images" / name
        images.mkdir(parents=True)
        lens.save(folder / f"{name}.yaml")
        write_image(images / "mask.png", whole_pixels(lens).astype(np.uint8) * 255)
        cameras[name] = {
            "file": f"{name}.yaml",
            "camera_from_reference": camera_from_left.tolist(),
        }
        poses = [pose @ inverse(camera_from_left) for pose in path]
        for number, image in enumerate(render_views(hall, lens, poses, progress)):
            write_image(images / f"{number:03d}.png", image[..., ::-1])
            frames.append(
                Frame(
                    f"{name}/{number:03d}", images / f"{number:03d}.png", lens, poses[number],
                    mask_path=images / "mask.png",
                )
            )  # fmt: skip
    rig = json.dumps({"cameras": cameras}, indent=1) + "\n"
    (folder / "rig.json").write_text(rig, encoding="utf-8")
    write_transforms(folder / "transforms.json", frames)
