"""The file of a rig: each camera's lens and place, as `gsut calibrate` or Kalibr write them."""

from __future__ import annotations

import dataclasses
import json
import math
import os
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import InputError, Shutter
from gsut.data.errors import DatasetError
from gsut.data.poses import check_rigid, find_centers, invert_pose
from gsut.files import read_json, read_yaml, register_reader, write_file
from gsut.lens import Camera, load_camera
from gsut.lens.files import is_camchain

_GIVE_RIG = "give the report.json that `gsut calibrate --rig` wrote, or a camchain YAML of Kalibr"
_POSE = "camera_from_reference"
_LENS = "file"
_SHUTTER = "shutter"
_READOUT = "readout_seconds"
_GLOBAL = "global"
_FEWEST_CAMERAS = 2
_NO_BASELINE = 1e-9  # of the distance to the reference, in units in the last place of a file


@dataclasses.dataclass(frozen=True)
class LineReading:
    """How a camera with a rolling shutter reads its lines.

    Args:
        shutter: their order.
        seconds: from the first line to the last; None: not known.
    """

    shutter: Shutter
    seconds: float | None = None


@dataclasses.dataclass(frozen=True)
class Rig:
    """Cameras that are fixed to each other.

    Args:
        source: the file it was read from.
        names: of the cameras; the first is the reference where the file says no other.
        cameras: their lenses; None: to be estimated.
        camera_from_reference: (K, 4, 4) in the unit of the file, metres where it was calibrated
            in metres.
        lens_files: where the lenses stand, and the camera's name there if there are several; None
            for a lens to be estimated.
        readings: how each camera reads its lines, None for all at once; empty: nothing is said.
    """

    source: Path
    names: tuple[str, ...]
    cameras: tuple[Camera | None, ...]
    camera_from_reference: np.ndarray
    lens_files: tuple[tuple[Path, str | None] | None, ...]
    readings: tuple[LineReading | None, ...] = ()

    def __len__(self) -> int:
        return len(self.names)

    @property
    def baseline(self) -> float:
        """The longest distance between two cameras."""
        centers = find_centers(self.camera_from_reference)
        return float(np.linalg.norm(centers[:, None] - centers[None], axis=2).max())

    @property
    def unknown_lenses(self) -> list[int]:
        """Numbers of the cameras whose lens is to be estimated."""
        return [number for number, file in enumerate(self.lens_files) if file is None]

    def forget_lenses(self) -> Rig:
        """Returns the same rig with every lens to be estimated."""
        nothing = (None,) * len(self)
        return dataclasses.replace(self, cameras=nothing, lens_files=nothing)


@register_reader("rig", ".json", ".yaml", ".yml", advice=_GIVE_RIG)
def read_rig(path: str | os.PathLike[str]) -> Rig:
    """Reads a rig.

    Either JSON as `gsut calibrate --rig` writes it (report.json): {"cameras": {NAME: {"file": lens
    file, relative to this one, or null to have the lens estimated, "camera_from_reference": six
    numbers (Rodrigues rotation, translation) or a 4x4 matrix}}}; or a camchain YAML of Kalibr
    (T_cn_cnm1), whose cameras are cam0, cam1 ... A camera of a JSON file may have a rolling
    shutter: "shutter", the order of its lines (see `Shutter`), and "readout_seconds" from the
    first to the last.

    Args:
        path: the file.

    Returns:
        The cameras by name, with their lenses and poses.

    Raises:
        InputError: no such file, not a rig, one camera only, or all cameras in one place: then
            nothing sets the scale.
        CalibrationError: a lens file is broken.
    """
    file = Path(path)
    is_yaml = file.suffix.lower() in (".yaml", ".yml")
    rig = _read_camchain_rig(file) if is_yaml else _read_json_rig(file)
    if len(rig) < _FEWEST_CAMERAS:
        raise InputError(
            f"{file} holds {len(rig)} camera; a rig has at least {_FEWEST_CAMERAS}: calibrate all "
            "of them together with `gsut calibrate --rig left,right`"
        )
    shifts = np.linalg.norm(rig.camera_from_reference[:, :3, 3], axis=1)
    if not rig.baseline > _NO_BASELINE * shifts.max(initial=0.0):
        raise InputError(
            f"{file}: all {len(rig)} cameras ({', '.join(rig.names)}) are in one place, so their "
            "baseline, 0, sets no scale; give each its measured camera_from_reference"
        )
    return rig


def write_rig(rig: Rig, path: Path) -> None:
    """Writes a rig as JSON that `read_rig` reads; lens files are named relative to it.

    Raises:
        InputError: the file cannot be written.
    """
    cameras: dict[str, Any] = {}
    readings = rig.readings or (None,) * len(rig)
    for name, pose, file, reading in zip(
        rig.names, rig.camera_from_reference, rig.lens_files, readings, strict=True
    ):
        own = cameras[name] = {_LENS: None, _POSE: pose.tolist()}
        if file is not None:
            lens, entry = file
            relative = os.path.relpath(lens.resolve(), path.parent.resolve())
            own |= {_LENS: Path(relative).as_posix()}
            own |= {} if entry is None else {"camera_id": entry}
        if rig.readings:
            own[_SHUTTER] = reading.shutter.direction if reading else _GLOBAL
        if reading is not None and reading.seconds is not None:
            own[_READOUT] = reading.seconds
    text = json.dumps({"cameras": cameras}, indent=1) + "\n"
    write_file(path, text)


def _read_json_rig(file: Path) -> Rig:
    values = read_json(file, advice=_GIVE_RIG)
    cameras = values.get("cameras") if isinstance(values, dict) else None
    if not isinstance(cameras, dict) or not cameras:
        raise InputError(
            f'{file}: there is no object "cameras" of names with "{_LENS}" and "{_POSE}"; give the '
            "report.json that `gsut calibrate --rig` wrote"
        )
    lenses: list[Camera | None] = []
    poses: list[np.ndarray] = []
    files: list[tuple[Path, str | None] | None] = []
    for name, entry in cameras.items():
        where = f"{file}, camera {name}"
        if not isinstance(entry, dict) or not isinstance(entry.get(_LENS, 0), str | None):
            raise InputError(
                f'{where}: "{_LENS}" does not name its lens file; write it there, or null to have '
                "the lens estimated"
            )
        if _POSE not in entry:
            raise InputError(f'{where}: "{_POSE}" is missing; calibrate the cameras together')
        poses.append(_parse_pose(entry[_POSE], where))
        if entry[_LENS] is None:
            lenses.append(None)
            files.append(None)
            continue
        camera_id = entry.get("camera_id")
        lens = file.parent / entry[_LENS]
        if not lens.is_file():
            raise InputError(f"{where}: there is no lens file {lens}; put it there")
        lenses.append(load_camera(lens, camera_id))
        files.append((lens, camera_id))
    readings = tuple(
        _parse_reading(entry, f"{file}, camera {name}") for name, entry in cameras.items()
    )
    if any(readings) and len({r.seconds is None for r in readings if r is not None}) > 1:
        raise InputError(
            f'{file}: "{_READOUT}" is given for some cameras with a rolling shutter only; give it '
            "for all of them, or for none"
        )
    is_said = any(_SHUTTER in entry for entry in cameras.values())
    return Rig(
        file, tuple(cameras), tuple(lenses), np.array(poses), tuple(files),
        readings if is_said else (),
    )  # fmt: skip


def _parse_reading(entry: dict[str, Any], where: str) -> LineReading | None:
    """Parses how a camera reads its lines; None: all at once, or nothing is said."""
    seconds = entry.get(_READOUT)
    direction = entry.get(_SHUTTER, _GLOBAL)
    is_number = isinstance(seconds, (int, float)) and not isinstance(seconds, bool)
    if seconds is not None and not (is_number and 0 < seconds < math.inf):
        raise InputError(f'{where}: "{_READOUT}" is {seconds!r}; give seconds above 0')
    if direction == _GLOBAL:
        if seconds is not None:
            raise InputError(
                f'{where}: "{_READOUT}" needs "{_SHUTTER}", the order of the lines, such as '
                '"top_to_bottom"'
            )
        return None
    try:
        return LineReading(Shutter(str(direction)), None if seconds is None else float(seconds))
    except InputError as error:
        raise InputError(f'{where}: "{_SHUTTER}": {error}') from error


def _read_camchain_rig(file: Path) -> Rig:
    rows = read_camchain(file)
    for name, _, from_reference, *_ in rows:
        if from_reference is None:
            raise InputError(f"{file}, camera {name}: T_cn_cnm1, its pose, is missing")
    names = tuple(row[0] for row in rows)
    poses = np.array([row[2] for row in rows])
    return Rig(file, names, tuple(row[1] for row in rows), poses, tuple((file, n) for n in names))


def read_camchain(
    file: Path,
) -> list[tuple[str, Camera, np.ndarray | None, np.ndarray | None, float]]:
    """Reads the cameras of a Kalibr camchain.

    Returns:
        Of each its name, lens, camera_from_cam0 (by T_cn_cnm1) and camera_from_imu (T_cam_imu, the
        inverse of T_imu_cam, or that of another camera through T_cn_cnm1), both (4, 4) or None
        where the file does not say, and timeshift_cam_imu: seconds, time of the IMU minus that of
        the camera.

    Raises:
        InputError: not YAML, or no camchain.
        CalibrationError: a lens is broken.
    """
    values = read_yaml(file)
    if not is_camchain(values):
        raise InputError(f"{file}: holds no cam0, cam1 ...; give a camchain of Kalibr, or JSON")
    names = [str(key) for key in values if str(key).startswith("cam")]
    from_first: list[np.ndarray | None] = []
    from_imu: list[np.ndarray | None] = []
    for number, name in enumerate(names):
        where, entry = f"{file}, camera {name}", values[name]
        step = entry.get("T_cn_cnm1") if isinstance(entry, dict) else None
        imu = entry.get("T_cam_imu") if isinstance(entry, dict) else None
        back = entry.get("T_imu_cam") if isinstance(entry, dict) and imu is None else None
        pose = np.eye(4) if number == 0 else None
        before = from_first[-1] if number else None
        if number and step is not None and before is not None:
            pose = _parse_pose(step, where) @ before
        from_first.append(pose)
        pose = None if imu is None else _parse_pose(imu, where)
        from_imu.append(pose if back is None else invert_pose(_parse_pose(back, where)))
    known = next((k for k, pose in enumerate(from_imu) if pose is not None), None)
    if known is not None:
        for k, pose in enumerate(from_first):
            first = from_first[known]
            if from_imu[k] is None and pose is not None and first is not None:
                from_imu[k] = pose @ invert_pose(first) @ from_imu[known]
    return [
        (name, load_camera(file, name), from_first[k], from_imu[k],
         float(values[name].get("timeshift_cam_imu") or 0.0))
        for k, name in enumerate(names)
    ]  # fmt: skip


def _parse_pose(values: Any, where: str) -> np.ndarray:
    """Parses a pose (4, 4), given as six numbers or a matrix."""
    import cv2

    try:
        array = np.array(values, np.float64)
    except (TypeError, ValueError):
        array = np.empty(0)
    if array.shape == (6,) and np.isfinite(array).all():
        pose = np.eye(4)
        pose[:3, :3] = cv2.Rodrigues(array[:3])[0]
        pose[:3, 3] = array[3:]
        return pose
    if array.shape in ((4, 4), (3, 4)):
        return check_rigid(array, where)
    raise DatasetError(
        where,
        "its pose is neither six numbers (Rodrigues rotation, translation) nor a 4x4 matrix",
        "write one of them",
    )


def measure_changes(given: Rig, found: np.ndarray) -> list[tuple[float, float]]:
    """Measures each camera's turn, in radians, and shift, in the rig's unit, against the file.

    Args:
        given: as read. found: (K, 4, 4) camera_from_reference now.
    """
    import cv2

    changes = []
    for before, after in zip(given.camera_from_reference, found, strict=True):
        step = after @ invert_pose(before)
        turn = float(np.linalg.norm(cv2.Rodrigues(step[:3, :3])[0]))
        centers = find_centers(np.stack([before, after]))
        changes.append((turn, float(np.linalg.norm(centers[1] - centers[0]))))
    return changes
