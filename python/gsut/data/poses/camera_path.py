"""Camera paths read from JSON files."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.data.poses.transforms import OPENGL_FROM_OPENCV, check_rigid
from gsut.files import read_json, register_reader

_HALF_TURN = 180.0  # degrees: no plain lens sees as much
_SAVE_AGAIN = "save the camera path again"


@register_reader("camera path", ".json", advice=_SAVE_AGAIN)
def read_path(path: str | os.PathLike[str], world_offset: np.ndarray | None = None) -> np.ndarray:
    """Reads the poses of a JSON file.

    Three forms are known: {"camera_from_world": [4x4, ...]} (OpenCV axes), nerfstudio's camera
    path {"camera_path": [{"camera_to_world": 16 numbers}, ...]} and a transforms.json {"frames":
    [{"transform_matrix": 4x4}, ...]} (both OpenGL axes, camera to world).

    Args:
        path: the file; its coordinates are the dataset's.
        world_offset: (3,) dataset coordinates minus scene coordinates; zero if None.

    Returns:
        (N, 4, 4) float64 camera_from_world in the scene's coordinates.

    Raises:
        InputError: no such file, not JSON, none of the known forms, or a pose that is not rigid.
    """
    path, content = Path(path), _read_content(path)
    try:
        if "camera_from_world" in content:
            entries, opengl = content["camera_from_world"], False
        elif "camera_path" in content:
            entries = [
                np.reshape(entry["camera_to_world"], (4, 4)) for entry in content["camera_path"]
            ]
            opengl = True
        else:
            entries, opengl = [entry["transform_matrix"] for entry in content["frames"]], True
    except (KeyError, TypeError, ValueError):
        raise InputError(
            f"{path}: not a camera path; a JSON object with camera_from_world (a list of 4x4 "
            "matrices), camera_path or frames is needed"
        ) from None
    if not entries:
        raise InputError(f"{path}: the camera path holds no pose")
    poses = [check_rigid(entry, f"{path}, pose {i}") for i, entry in enumerate(entries)]
    matrices = np.stack(poses)
    if opengl:
        matrices = np.linalg.inv(matrices @ OPENGL_FROM_OPENCV)
    world_from_scene = np.eye(4)
    if world_offset is not None:
        world_from_scene[:3, 3] = world_offset
    return matrices @ world_from_scene


@register_reader("lens of a camera path", ".json", advice=_SAVE_AGAIN)
def read_path_lens(path: str | os.PathLike[str]) -> Any:
    """Reads the lens that a camera path carries, as values of a lens file; None without one.

    The viewer saves one; a path of nerfstudio has a size and a field of view.

    Raises:
        InputError: the lens of nerfstudio's path changes, or is of a kind that is not drawn.
    """
    content = _read_content(path)
    if "camera_path" not in content or "render_height" not in content:
        return content.get("lens")
    kind = str(content.get("camera_type", "perspective")).lower()
    try:
        width, height = int(content["render_width"]), int(content["render_height"])
        angles = {float(entry["fov"]) for entry in content["camera_path"]}
    except (KeyError, TypeError, ValueError, OverflowError):
        raise InputError(
            f"{path}: render_width, render_height and the fov of each pose are not all numbers; "
            "save it again, or give --camera"
        ) from None
    if kind == "equirectangular":
        return {"model": kind, "params": [], "width": width, "height": height}
    if kind != "perspective" or len(angles) != 1 or not 0 < min(angles) < _HALF_TURN:
        what = (
            f"camera_type '{kind}'" if kind != "perspective" else
            f"fields of view of {min(angles, default=0):g} to {max(angles, default=0):g} degrees"
        )  # fmt: skip
        raise InputError(f"{path}: {what}, and one plain lens is drawn; give another by --camera")
    focal = height / 2 / math.tan(math.radians(angles.pop()) / 2)  # fov is from top to bottom
    params = [focal, focal, width / 2, height / 2]
    return {"model": "pinhole", "params": params, "width": width, "height": height}


def read_path_turns(path: str | os.PathLike[str]) -> int:
    """Reads the quarter turns clockwise that show a camera path's images upright; 0 if unsaid."""
    turns = _read_content(path).get("turns", 0)
    if turns not in range(4):
        raise InputError(f'{path}: "turns" must be 0 to 3 quarter turns, found {turns!r}')
    return int(turns)


def _read_content(path: str | os.PathLike[str]) -> dict[str, Any]:
    content = read_json(path, advice=_SAVE_AGAIN)
    return content if isinstance(content, dict) else {}
