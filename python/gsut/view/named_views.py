"""Reads views with names for a page: of a photograph, or of poses that the viewer saved."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from gsut._core import InputError
from gsut.data.poses import read_path, read_path_lens, read_path_turns
from gsut.data.scene import find_upright_poses
from gsut.lens import Camera
from gsut.lens.files import camera_from_values
from gsut.orientation import turn_camera
from gsut.view.stage import Stage


@dataclasses.dataclass(frozen=True)
class NamedView:
    """A place to start from, or a flight.

    Attributes:
        name: for people.
        poses: (n, 4, 4) camera_from_world of the picture as it is shown; several are a flight.
        camera: the lens.
        turns: quarter turns clockwise that show its images upright.
    """

    name: str
    poses: np.ndarray
    camera: Camera
    turns: int = 0


def read_named_view(text: str, stage: Stage) -> NamedView:
    """Reads "NAME=WHERE": a photograph's name, or a JSON file of poses.

    Raises:
        InputError: there is no such photograph or file, or the file cannot be read.
    """
    name, equals, where = text.partition("=")
    if not (name.strip() and equals and where):
        raise InputError(
            f"--view {text}: give NAME=WHERE, where WHERE is a photograph's name or a JSON file of "
            "the viewer's Screenshot or Path"
        )
    scene = stage.scene
    for row, view in enumerate(() if scene is None else scene.views):
        if where in (view.name, Path(view.name).name):
            assert scene is not None
            poses = find_upright_poses(scene, [row])
            return NamedView(name.strip(), poses, scene.camera(row), view.turns)
    if Path(where).suffix.lower() != ".json":
        raise InputError(
            f"--view {text}: no photograph has the name {where}; give one of the scene's, or a "
            "JSON file of the viewer's Screenshot or Path"
        )
    turns, lens = read_path_turns(where), read_path_lens(where)
    offset = None if scene is None else scene.world_offset
    camera = stage.cameras[0] if lens is None else camera_from_values(lens, where)
    return NamedView(name.strip(), turn_camera(read_path(where, offset), turns), camera, turns)
