"""Writes the demo's hall as several cameras on one body see it, with the truth."""

from __future__ import annotations

import dataclasses
import json
import math
import os
from pathlib import Path

import numpy as np

from gsut._core import InputError, exp_pose
from gsut.data import Frame, write_transforms
from gsut.data.poses import invert_pose
from gsut.files import whole_folder, write_picture
from gsut.lens import Camera, save_camera
from lab.demo_tracer.dataset import (
    MILLIMETRES,
    find_whole_pixels,
    measure_distances,
    render_views,
)
from lab.demo_tracer.hall import make_hall
from lab.demo_tracer.views import make_camera, plan_walk

# The right camera of two: its lens in image sizes, Kannala-Brandt, seen to 80 degrees.
_FOCAL = (0.3315, 0.3309)
_CENTRE = (0.4952, 0.5041)
_DISTORTION = (-0.012, 0.004, -0.002, 0.0003)
_MAX_ANGLE = math.radians(80.0)
# Its place on the body, the left camera's frame: metres, and a turn (rotation vector, radians).
_PLACE = (0.24, 0.01, -0.02)
_TURN = (0.03, 0.12, -0.02)
# Four looking all around: name, then a0, cx and cy in image sizes, and c, d, e: pixels are not
# square and not upright, by as much as OCamCalib finds of real cameras. 220-degree circles.
_AROUND = (
    ("front", 0.2445, 0.5012, 0.4983, 1.0024, 4.1e-4, -9.0e-4),
    ("right", 0.2461, 0.4978, 0.5031, 0.9981, -7.2e-4, 3.5e-4),
    ("back", 0.2452, 0.5025, 0.5014, 1.0037, 1.1e-3, 6.0e-4),
    ("left", 0.2438, 0.4969, 0.4976, 0.9969, -3.0e-4, -1.2e-3),
)
# Their polynomials: a2 a0, a3 a0^2 and a4 a0^3, which have no unit.
_POLYNOMIAL = (-0.3333, 0.0040, -0.0318)
_WIDE_ANGLE = math.radians(110.0)
_ARM = 0.12  # metres from the body's middle to each of the four
_OFF_METRES = 0.01  # largest error of a mount's place
_OFF_RADIANS = 0.03  # largest error of its direction


@dataclasses.dataclass(frozen=True)
class Mounted:
    """A camera on a body.

    Attributes:
        name: of the camera, and of its folder.
        lens: as the pictures are made.
        camera_from_reference: (4, 4), metres; the first camera is the reference.
        file: of the lens.
    """

    name: str
    lens: Camera
    camera_from_reference: np.ndarray
    file: str


def make_rig(cameras: int, size: int) -> list[Mounted]:
    """Makes two fisheyes beside each other, or four of 220 degrees that look all around.

    Args:
        cameras: 2 or 4.
        size: of the square images, pixels.
    """
    if cameras == 2:
        return [
            Mounted("left", make_camera(size), np.eye(4), "left.yaml"),
            Mounted("right", make_right_camera(size), place_right(), "right.yaml"),
        ]
    rng = np.random.default_rng(4)
    found, front = [], np.eye(4)
    for number, (name, focal, cx, cy, *affine) in enumerate(_AROUND):
        a0 = focal * size
        poly = [value / a0**power for power, value in enumerate(_POLYNOMIAL, start=1)]
        lens = Camera(
            "ocam", [cx * size, cy * size, *affine, a0, *poly], size, size,
            valid_field_angle=_WIDE_ANGLE,
        )  # fmt: skip
        off = rng.uniform(-1, 1, 6) * np.repeat([_OFF_METRES, _OFF_RADIANS], 3)
        about = exp_pose([0.0, 0.0, 0.0, 0.0, -number * math.pi / 2, 0.0])  # y points down
        about[2, 3] = -_ARM
        pose = exp_pose(off) @ about
        front = invert_pose(pose) if number == 0 else front
        found.append(Mounted(name, lens, pose @ front, f"{name}/{name}.lens.json"))
    return found


def make_right_camera(size: int) -> Camera:
    """Makes the second lens, for square images of `size` pixels a side."""
    params = [size * value for value in (*_FOCAL, *_CENTRE)] + list(_DISTORTION)
    return Camera("kannala_brandt", params, size, size, valid_field_angle=_MAX_ANGLE)


def place_right() -> np.ndarray:
    """Returns the pose (4, 4) of the right camera from the left one, in metres."""
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
    cameras: int = 2,
    first: int = 0,
) -> Path:
    """Makes a small data set of a rig with exact truth: fisheyes on one body in a hall.

    Writes images/NAME/*.png of each camera (the same file name: the same frame) with a mask.png,
    rig.json (as `gsut calibrate --rig` writes its report.json: lenses and camera_from_reference,
    metres) and, as truth, transforms.json and depth/NAME/*.png (distance along the ray in mm, 16
    bits, 0 outside the circle). Lenses of two cameras, left and right, are left.yaml and
    right.yaml (OpenCV); of four, which look all around through 220 degrees, they are
    NAME/NAME.lens.json.

    Args:
        folder: is created; appears only when it is complete.
        frames: number of images of each camera.
        size: width and height of the images, pixels.
        seed: of textures and path; the same seed gives the same bytes.
        progress: show a progress bar on stderr.
        path_share: of the demo's path, above 0 and up to 1, that the rig goes.
        cameras: 2 or 4.
        first: number of poses of the path that are skipped.

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
    if cameras not in (2, 4):
        raise InputError(f"cameras is {cameras}; the demo has rigs of 2 and of 4")
    path = plan_walk(round(frames / path_share), seed)[first : first + frames]
    with whole_folder(folder) as partial:
        _write(partial, path, make_rig(cameras, size), seed, progress)
    return folder


def _write(
    folder: Path, path: list[np.ndarray], rig: list[Mounted], seed: int, progress: bool
) -> None:
    hall, frames, cameras = make_hall(seed), [], {}
    for mounted in rig:
        name, lens = mounted.name, mounted.lens
        images, depths = folder / "images" / name, folder / "depth" / name
        images.mkdir(parents=True)
        depths.mkdir(parents=True)
        (folder / mounted.file).parent.mkdir(exist_ok=True)
        save_camera(lens, folder / mounted.file)
        write_picture(images / "mask.png", find_whole_pixels(lens).astype(np.uint8) * 255)
        cameras[name] = {
            "file": mounted.file,
            "camera_from_reference": mounted.camera_from_reference.tolist(),
        }
        rays, inside = lens.rays()
        poses = [pose @ invert_pose(mounted.camera_from_reference) for pose in path]
        for number, image in enumerate(render_views(hall, lens, poses, progress)):
            file = f"{number:03d}.png"
            write_picture(images / file, image[..., ::-1])
            depth = np.zeros(inside.shape, np.uint16)
            away = measure_distances(hall, poses[number], rays[inside])
            depth[inside] = np.round(away * MILLIMETRES)
            write_picture(depths / file, depth)
            frames.append(
                Frame(
                    f"{name}/{number:03d}", images / file, lens, poses[number],
                    mask_path=images / "mask.png", depth_path=depths / file,
                )
            )  # fmt: skip
    rig_file = json.dumps({"cameras": cameras}, indent=1) + "\n"
    (folder / "rig.json").write_text(rig_file, encoding="utf-8")
    write_transforms(folder / "transforms.json", frames)
