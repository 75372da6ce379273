"""dataset.yaml: says where pictures, lenses and poses are, where they lie apart.

images: cam0/data             a folder of pictures, or of a known layout (mav0), or {cam0: folder}
lens: camchain.yaml           any lens file, a camchain, a rig.json, or {cam0: file}
poses: slam/trajectory.txt    TUM, EuRoC or KITTI trajectory, or poses.json
points: cloud.ply             may be absent, as all that follows
masks: masks                  white where pixels count, named as the pictures
poses_of: body                or camera (each its own), or cam0
cameras: [cam0]               those to use
time_offset: 0.013            seconds: time of the poses' clock minus that of the pictures'
time_tolerance: 0.02          seconds between a picture and its nearest pose
image_times: ns               unit of the pictures' times: s, ms, us, ns; pose_times: of the poses'

Paths are from the file's folder. Other keys are refused, by name.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gsut.data.errors import DatasetError
from gsut.data.layouts._layout import Layout, find_layout
from gsut.data.layouts.folder import DESCRIPTION, POINT_FILES, find_images
from gsut.data.poses import UNITS
from gsut.data.recordings import Recording, find_stream
from gsut.data.rigs import read_mounts
from gsut.files import read_text, read_yaml

_PATHS = ("images", "lens", "poses", "points", "masks")
KEYS = (
    *_PATHS, "poses_of", "cameras", "time_offset", "time_tolerance", "image_times", "pose_times",
)  # fmt: skip


def record(path: Path) -> Recording:
    """Reads a dataset.yaml, or the one in a folder, as a recording."""
    file = path / DESCRIPTION if path.is_dir() else path
    recording = describe_recording(read_yaml(file), file.parent, file)
    if file.name != DESCRIPTION:
        recording.path = file  # so that a run finds this one again
    return recording


def describe_recording(values: Mapping[str, Any], folder: Path, file: Path) -> Recording:
    """Makes the recording that these keys describe.

    Args:
        values: by the keys at the top of this file.
        folder: where relative paths begin.
        file: for messages.

    Raises:
        DatasetError: an unknown key, a wrong value, or a path that does not exist.
    """
    wrong = [str(key) for key in values if key not in KEYS]
    if wrong:
        raise _report(file, wrong[0], "is no key of it", f"use {', '.join(KEYS)}")
    for key in _PATHS:
        for path in _list_paths(values.get(key), folder):
            if not path.exists():
                raise _report(file, key, f"{path} does not exist", "correct the path")
    recording = _find_pictures(values.get("images", "."), folder, file)
    recording.path = folder
    return replace_parts(recording, values, folder, file)


def replace_parts(
    recording: Recording, values: Mapping[str, Any], folder: Path, file: Path
) -> Recording:
    """Replaces the parts of a recording that these keys state; see `describe_recording`."""
    lens = values.get("lens")
    if lens is not None:
        found = {str(k): folder / str(v) for k, v in lens.items()} if isinstance(lens, dict) else (
            folder / str(lens)
        )  # fmt: skip
        recording.mounts = functools.partial(read_mounts, found)
    if values.get("poses") is not None:
        recording.poses = folder / str(values["poses"])
        recording.body_from_poses, recording.pose_times = None, None
        if values.get("lens") is not None:
            recording.poses_of = None
    for key in ("points", "masks"):
        if values.get(key) is not None:
            setattr(recording, key, folder / str(values[key]))
    if "cameras" in values:
        wanted = values["cameras"]
        recording.cameras = tuple(map(str, wanted if isinstance(wanted, list) else [wanted]))
    if values.get("poses_of") is not None:
        recording.poses_of = str(values["poses_of"])
    numbers = _read_numbers(values, file)
    units = {key: str(values[key]) for key in ("image_times", "pose_times") if key in values}
    for key, unit in units.items():
        if unit not in UNITS:
            raise _report(file, key, f"{unit!r} is no unit of time", f"use {', '.join(UNITS)}")
    for key, value in (numbers | units).items():
        setattr(recording, key, value)
    return recording


def _list_paths(value: Any, folder: Path) -> list[Path]:
    if value is None:
        return []
    return [folder / str(v) for v in (value.values() if isinstance(value, dict) else [value])]


def _find_pictures(value: Any, folder: Path, file: Path) -> Recording:
    if isinstance(value, dict):
        streams = [find_stream(str(name), folder / str(sub)) for name, sub in value.items()]
        empty = [s.name for s in streams if not s.images]
        if empty:
            raise _report(
                file, "images", f"there are no pictures of {empty[0]}", "correct the path"
            )
        return Recording(folder, streams, names_from=folder)

    path = folder / str(value)
    layout = find_layout(path, without=("dataset.yaml", "folder"))
    if layout is not None and layout.record is not None:
        recording = layout.record(path)
        recording.names_from = recording.names_from or path
        return recording
    stream = find_stream((path.parent if path.name == "data" else path).name, path)
    if not stream.images:
        stream.images = find_images(path)
    points = next((folder / n for n in POINT_FILES if (folder / n).is_file()), None)
    return Recording(folder, [stream], names_from=path, points=points)


def _read_numbers(values: Mapping[str, Any], file: Path) -> dict[str, Any]:
    found: dict[str, Any] = {}
    try:
        for key in ("time_offset", "time_tolerance"):
            if key in values:
                found[key] = float(values[key])
    except (TypeError, ValueError):
        what = f"expected a number of seconds, found {values[key]!r}"
        raise _report(file, key, what, "correct it") from None
    return found


def _report(file: Path, key: str, what: str, advice: str) -> DatasetError:
    number = 0
    if file.is_file():
        lines = read_text(file).splitlines()
        number = next((n for n, line in enumerate(lines, 1) if line.startswith(f"{key}:")), 0)
    line = f", line {number}" if number else ""
    return DatasetError(f"{file}{line}, '{key}'", what, advice)


LAYOUTS = (
    Layout(
        "dataset.yaml",
        "a description of where all is",
        rank=0,
        holds=lambda path: (
            (path / DESCRIPTION).is_file()
            or (path.is_file() and path.suffix.lower() in (".yaml", ".yml"))
        ),
        record=record,
    ),
)
