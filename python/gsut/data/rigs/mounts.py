"""Lenses of a recording's cameras, and where each sits on the body that the poses are of."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsut.data.errors import DatasetError
from gsut.data.poses import NANOSECONDS, check_rigid, invert_pose
from gsut.data.rigs.rig import read_camchain, read_rig
from gsut.files import read_json, read_yaml
from gsut.lens import Camera, load_camera
from gsut.lens.files import is_camchain

BODY = "body"  # what poses are of: the body (an IMU), each camera itself, or one named camera
OWN = "camera"
_YAML = (".yaml", ".yml")


@dataclasses.dataclass(frozen=True)
class Mount:
    """One camera.

    Args:
        camera: its lens.
        source: the file, for messages.
        from_body: (4, 4) camera from body (IMU), or None where the file does not say.
        from_reference: (4, 4) camera from the rig's reference camera, or None.
        clock_shift: nanoseconds to add to the images' times, for the clock of the poses.
    """

    camera: Camera
    source: str
    from_body: np.ndarray | None = None
    from_reference: np.ndarray | None = None
    clock_shift: int = 0


def read_mounts(lens: Path | dict[str, Path], names: Sequence[str]) -> dict[str, Mount]:
    """Reads lens and place of each camera.

    Args:
        lens: one file for all of them: a camchain of Kalibr, a rig.json (see `read_rig`), or any
            lens file, which then is the lens of every camera; or a file for each.
        names: of the cameras, as their folders are called.

    Raises:
        DatasetError: a camera has no lens there.
        CalibrationError, InputError: a file is broken.
    """
    if isinstance(lens, dict):
        absent = [name for name in names if name not in lens]
        if absent:
            raise DatasetError(
                ", ".join(map(str, lens.values())) or "lens",
                f"camera {absent[0]} has no lens file, only {', '.join(lens) or 'none'} have",
                "name one for each camera",
            )
        return {name: _read_mount(lens[name], name) for name in names}
    if lens.suffix.lower() in _YAML:
        values = read_yaml(lens)
        if is_camchain(values):
            return _select_mounts(_read_mounts_of_camchain(lens), names, lens)
    elif lens.suffix.lower() == ".json" and _is_rig(read_json(lens)):
        rig = read_rig(lens)
        rows = zip(rig.names, rig.cameras, rig.camera_from_reference, strict=True)
        mounts = {
            name: Mount(camera, f"{lens}, camera {name}", from_reference=pose)
            for name, camera, pose in rows
            if camera is not None
        }
        return _select_mounts(mounts, names, lens)
    mount = _read_mount(lens, "")
    return dict.fromkeys(names, mount)


def is_rig_file(lens: Path) -> bool:
    """Returns whether a lens file holds several cameras that are fixed to each other.

    Raises:
        DatasetError: it cannot be read.
    """
    if lens.suffix.lower() == ".json":
        return _is_rig(read_json(lens))
    if lens.suffix.lower() not in _YAML:
        return False
    return sum(is_camchain({key: None}) for key in read_yaml(lens)) > 1


def _is_rig(values: Any) -> bool:
    cameras = values.get("cameras") if isinstance(values, dict) else None
    return isinstance(cameras, dict) and any(
        isinstance(entry, dict) and "camera_from_reference" in entry for entry in cameras.values()
    )


def _select_mounts(mounts: dict[str, Mount], names: Sequence[str], lens: Path) -> dict[str, Mount]:
    if len(mounts) == 1 and len(names) == 1:
        return dict(zip(names, mounts.values(), strict=True))
    absent = [name for name in names if name not in mounts]
    if absent:
        raise DatasetError(
            lens,
            f"it holds the cameras {', '.join(mounts)}, and the pictures are of '{absent[0]}'",
            "name the pictures' folders as the file names its cameras, or say in dataset.yaml "
            f"which is which: `images: {{{next(iter(mounts))}: FOLDER}}`",
        )
    return {name: mounts[name] for name in names}


def _read_mount(lens: Path, name: str) -> Mount:
    """Reads a file of one camera, a camchain's camera of this name, or EuRoC's sensor.yaml."""
    if lens.suffix.lower() in _YAML:
        values = read_yaml(lens)
        if is_camchain(values):
            return _select_mounts(_read_mounts_of_camchain(lens), [name], lens)[name]
        if "T_BS" in values:
            from_body = invert_pose(
                check_rigid(parse_matrix(values["T_BS"]), f"{lens}, key 'T_BS'")
            )
            return Mount(load_camera(lens), str(lens), from_body)
    camera = load_camera(lens)
    return Mount(camera, str(lens))


def parse_matrix(values: Any) -> Any:
    """Parses a matrix of nested lists, or EuRoC's dictionary with 16 numbers in `data`."""
    data = values.get("data") if isinstance(values, dict) else values
    if isinstance(data, list) and len(data) == 16:
        return [data[4 * row : 4 * row + 4] for row in range(4)]
    return data


def _read_mounts_of_camchain(file: Path) -> dict[str, Mount]:
    return {
        name: Mount(camera, f"{file}, camera {name}", from_body, from_reference,
                    round(shift * NANOSECONDS))
        for name, camera, from_reference, from_body, shift in read_camchain(file)
    }  # fmt: skip


def find_body_from_camera(name: str, mounts: dict[str, Mount], poses_of: str | None) -> np.ndarray:
    """Finds the transform (4, 4) from this camera to what the trajectory's poses are of.

    Args:
        name: the camera.
        mounts: of all cameras.
        poses_of: "body", "camera" (each its own), a camera's name; None: the body where the lens
            files place cameras on one, else the camera, if it is the only one.

    Raises:
        DatasetError: the files do not say where the camera is.
    """
    mount = mounts[name]
    if poses_of is None:
        if mount.from_body is None and len(mounts) == 1:
            return np.eye(4)
        poses_of = BODY
    if poses_of in (OWN, name):
        return np.eye(4)
    if poses_of == BODY:
        if mount.from_body is None:
            raise DatasetError(
                mount.source,
                "there is no T_cam_imu or T_imu_cam (Kalibr) or T_BS (EuRoC), so that the poses of "
                "the body say nothing of this camera",
                "add it; or, where the poses are those of a camera, write `poses_of: "
                f"{next(iter(mounts)) or 'camera'}` into dataset.yaml",
            )
        return invert_pose(mount.from_body)
    if poses_of not in mounts:
        raise DatasetError(
            mount.source,
            f"`poses_of: {poses_of}` is none of {BODY}, {OWN}, {', '.join(mounts)}",
            "name one of them",
        )
    other = mounts[poses_of]
    for kind in ("from_reference", "from_body"):
        mine, its = getattr(mount, kind), getattr(other, kind)
        if mine is not None and its is not None:
            return its @ invert_pose(mine)
    raise DatasetError(
        mount.source,
        f"it does not say where {name} sits against {poses_of}",
        "give a camchain (T_cn_cnm1), a rig.json or sensor.yaml files (T_BS) as the lens",
    )
