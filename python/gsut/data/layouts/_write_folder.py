"""Writes a plain folder: images/, lens files of gsut's own form, poses.txt; holds every lens."""

from __future__ import annotations

from pathlib import Path, PurePosixPath

import numpy as np

from gsut._core import InputError
from gsut.data.export import POINTS, Export, losses, place_images
from gsut.data.trajectory import format_tum
from gsut.files import write_file
from gsut.lens import OWN_SUFFIX, Camera


def write_folder(folder: Path, export: Export) -> list[str]:
    """Writes the dataset; returns what the layout cannot hold.

    Raises:
        InputError: several lenses whose images lie in one folder, or a name with numbers alone.
    """
    lenses: dict[str, Camera] = {}
    several = len({frame.camera for frame in export.frames}) > 1
    frames = place_images(export, folder)
    for frame in frames:
        camera = PurePosixPath(frame.name).parts[0] if several else "lens"
        if lenses.setdefault(camera, frame.camera) != frame.camera or (
            several and "/" not in frame.name
        ):
            raise InputError(
                "a plain folder with several lenses has the images of each in a folder of its own,"
                f" and {frame.name} is beside images of another; write it as nerfstudio"
            )
    for name, lens in lenses.items():
        lens.save(folder / f"{name}{OWN_SUFFIX}")
    poses = np.array([frame.world_from_camera for frame in frames])
    write_file(folder / "poses.txt", format_tum([frame.name for frame in frames], poses))
    export.write_points(folder / POINTS)
    return losses(export, "a plain folder", masks=True)
