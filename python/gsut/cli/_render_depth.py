"""What `gsut render` writes beside images: depths, with poses and lenses, and a cloud."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import CameraMotion, InputError
from gsut.data import Frame, write_transforms
from gsut.data.poses import invert_pose
from gsut.files import refuse_existing, write_npy
from gsut.render import measure_depth, write_png, z_from_distance
from gsut.surface import Cloud, DepthMap, save_mesh
from gsut.terminal import say

_DEPTH = "depth"
_LEVELS = np.iinfo(np.uint16).max  # of a 16-bit picture
UNIT = 1e-3  # of the dataset's, in a level: millimetres of a scene in metres


class DepthOutput:
    """Depths and points of images as they are rendered.

    Args:
        arguments: of `gsut render`.
    """

    def __init__(self, arguments: argparse.Namespace) -> None:
        self._along = arguments.depth
        self._file = Path(arguments.cloud) if arguments.cloud else None
        self._cloud = Cloud(None)
        self._frames: list[Frame] = []
        self._too_far = self._known = 0

    @classmethod
    def from_flags(cls, arguments: argparse.Namespace, film: bool) -> DepthOutput | None:
        """Makes the writer that the flags request; None without depths and a cloud.

        Raises:
            InputError: depths of a film, a unit out of range, or a file that exists.
        """
        if arguments.depth is None and not arguments.cloud:
            return None
        if arguments.depth and film:
            raise InputError("a film has no depths: give a folder by -o, not a film's name")
        if arguments.cloud:
            file = Path(arguments.cloud)
            if file.suffix.lower() != ".ply":
                raise InputError(f"{file}: clouds are written as .ply")
            refuse_existing(file)
        return cls(arguments)

    def check(self, cameras: Sequence[Any]) -> None:
        """Raises InputError where a lens sees too far from its axis for z."""
        for camera in dict.fromkeys(cameras) if self._along == "z" else ():
            z_from_distance(np.zeros((camera.height, camera.width)), camera)

    def add(self, folder: Path | None, shot: Any, result: Any, image: np.ndarray) -> None:
        """Writes one image's depth; `image` is the render as bytes."""
        name, camera, place = shot.name, shot.camera, shot.place
        if self._file is not None:
            distance = measure_depth(result)
            self._cloud.add(DepthMap(camera, place, distance, None, image))
        if self._along is None or folder is None:
            return
        self._folder = folder
        depth = measure_depth(result, along=self._along)
        (folder / _DEPTH).mkdir(exist_ok=True)
        file = folder / _DEPTH / f"{name}.npy"
        write_npy(file, depth.astype(np.float32))
        with np.errstate(invalid="ignore"):
            levels = np.rint(depth / UNIT)
            fits = levels <= _LEVELS
        self._known += int(np.isfinite(levels).sum())
        self._too_far += int((levels > _LEVELS).sum())
        write_png(file.with_suffix(".png"), np.where(fits, levels, 0).astype(np.uint16))
        poses: dict[str, Any]
        if isinstance(place, CameraMotion):
            poses = {
                "world_from_camera": invert_pose(place.at(0.5)),
                "world_from_camera_start": invert_pose(place.at(0.0)),
                "world_from_camera_end": invert_pose(place.at(1.0)),
                "shutter": place.shutter,
            }
        else:
            poses = {"world_from_camera": invert_pose(np.asarray(place, np.float64))}
        # By that name a dataset's depths are along the rays.
        along_rays = file if self._along == "ray" else None
        self._frames.append(
            Frame(name, folder / f"{name}.png", camera, depth_path=along_rays, **poses)
        )

    def finish(self) -> dict[str, Any]:
        """Writes the poses and the cloud; returns figures."""
        figures: dict[str, Any] = {}
        if self._frames:
            write_transforms(self._folder / "transforms.json", self._frames, test=())
            figures[_DEPTH] = self._along
        if self._too_far:
            share = self._too_far / self._known
            say(
                f"note: {share:.1%} of the depths are beyond {_LEVELS * UNIT:g} and 0 "
                f"in the 16-bit files; the .npy files hold them"
            )
        if self._file is not None:
            points = self._cloud.to_mesh()
            save_mesh(self._file, points)
            figures |= {"cloud": str(self._file), "points": len(points.vertices)}
        return figures
