"""Files of poses: TUM, EuRoC and KITTI trajectories, and JSON objects of names and matrices."""

from __future__ import annotations

import dataclasses
import functools
import re
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from gsut._core import InputError
from gsut.data.errors import DatasetError, OnError
from gsut.data.poses.times import is_time
from gsut.data.poses.transforms import check_rigid, pose_from_quaternion
from gsut.files import read_json, read_text, register_reader
from gsut.gaussians import quaternion_from_rotation

_TUM = 8  # fields of a line: label, position, quaternion
_KITTI = (12, 16)  # fields of a line: a 3x4 matrix, or a 4x4 one
_ADVICE = (
    "`gsut scene` makes a scene of photographs, `gsut poses` finds their poses alone; or write "
    "poses.txt with lines 'name tx ty tz qx qy qz qw' (camera-to-world, OpenCV axes)"
)


# The numbers of a line that end it, parted by blanks, with commas for points as spreadsheets have.
_DECIMAL_COMMAS = re.compile(r"(?:\s-?[0-9]+,[0-9]+(?:e-?[0-9]+)?){7}$", re.IGNORECASE)


@dataclasses.dataclass(frozen=True)
class Trajectory:
    """Poses in the order of their file.

    Args:
        source: the file.
        labels: of each pose, its time or the name of its image, as the file has it; None where the
            file has poses alone (KITTI).
        poses: (N, 4, 4) to the world, of what the file says it is.
    """

    source: Path
    labels: tuple[str, ...] | None
    poses: np.ndarray

    def __len__(self) -> int:
        return len(self.poses)

    @property
    def is_timed(self) -> bool:
        """Is true if every label is a number: then poses are paired by time instead of name."""
        return self.labels is not None and all(is_time(label) for label in self.labels)


@register_reader("trajectory", ".txt", ".csv", ".json", fails=DatasetError)
def read_trajectory(source: Path, on_error: OnError) -> Trajectory:
    """Reads poses from a file; its first line of numbers, or its suffix .json, says the format.

    TUM: `label tx ty tz qx qy qz qw`. EuRoC: the same with commas, the quaternion w first, and
    more columns after it. Either way a heading that names the columns decides on the quaternion's
    order. KITTI: the 12 numbers of a 3x4 matrix, row by row, or the 16 of a 4x4 one. JSON:
    {"name": 4x4 matrix}.

    Args:
        source: the file.
        on_error: receives each error of a single pose, which is left out if it returns.

    Raises:
        DatasetError: the file is missing, no text, or has no poses.
    """
    if source.suffix.lower() == ".json":
        labels, makers = _read_json_rows(source)
    else:
        labels, makers = _read_table_rows(source)
    if not makers:
        raise DatasetError(source, "it holds no pose", _ADVICE)
    kept, poses = [], []
    for index, make in enumerate(makers):
        try:
            poses.append(make())
            kept.append(index)
        except InputError as error:
            on_error(error)
    return Trajectory(
        source,
        None if labels is None else tuple(labels[i] for i in kept),
        np.array(poses).reshape(-1, 4, 4),
    )


_Make = Callable[[], np.ndarray]
_Rows = tuple[list[str] | None, list[_Make]]


def _read_json_rows(source: Path) -> _Rows:
    values = read_json(source)
    if not isinstance(values, dict) or "frames" in values:
        what = "not an object of names and matrices"
        is_nerfstudio = isinstance(values, dict)
        raise DatasetError(source, what, "call it transforms.json" if is_nerfstudio else _ADVICE)
    makers = [
        functools.partial(check_rigid, matrix, f"{source}, image {name}")
        for name, matrix in values.items()
    ]
    return list(values), list[_Make](makers)


def _read_table_rows(source: Path) -> _Rows:
    labels: list[str] = []
    makers: list[_Make] = []
    w_first: bool | None = None
    kitti: bool | None = None
    for number, line in enumerate(read_text(source).splitlines(), 1):
        line = line.strip()
        if not line:
            continue
        if line.startswith("#") or _is_heading(line):
            found = _has_w_first(line)
            w_first = found if found is not None else w_first
            continue
        place = f"{source}, line {number}"
        if kitti is None:
            kitti = len(line.split()) in _KITTI and all(is_time(v) for v in line.split())
        if kitti:
            makers.append(functools.partial(_parse_kitti_pose, line, place))
            continue
        if ";" in line or _DECIMAL_COMMAS.search(line):
            line = line.replace(",", ".").replace(";", " ")
        with_commas = "," in line
        fields = line.split(",")[:_TUM] if with_commas else line.rsplit(maxsplit=_TUM - 1)
        labels.append(fields[0].strip())
        order = with_commas if w_first is None else w_first
        makers.append(functools.partial(_parse_pose, fields, order, place, line))
    return None if kitti else labels, makers


def _is_heading(line: str) -> bool:
    """Returns whether a line names columns: it has no numbers, but the quaternion's names."""
    fields = re.split(r"[,;\s]+", line)
    return _has_w_first(line) is not None and not any(is_time(field) for field in fields)


def _has_w_first(heading: str) -> bool | None:
    """Returns whether a heading has the quaternion's w before its x; None without them."""
    places = [re.search(rf"\bq\w*{axis}\b", heading, re.IGNORECASE) for axis in "wx"]
    if places[0] is None or places[1] is None:
        return None
    return places[0].start() < places[1].start()


def _parse_pose(fields: list[str], w_first: bool, place: str, line: str) -> np.ndarray:
    order = "qw qx qy qz" if w_first else "qx qy qz qw"
    try:
        values = [float(field) for field in fields[1:]]
        if len(values) != _TUM - 1:
            raise ValueError
    except ValueError as error:
        place_and_show = line if len(line) <= 100 else line[:97] + "..."
        raise DatasetError(
            place, f"expected 'name tx ty tz {order}', found '{place_and_show}'", _ADVICE
        ) from error
    *translation, a, b, c, d = values
    return pose_from_quaternion([a, b, c, d] if w_first else [d, a, b, c], translation, place)


def _parse_kitti_pose(line: str, place: str) -> np.ndarray:
    try:
        return check_rigid(np.reshape([float(v) for v in line.split()], (-1, 4)), place)
    except ValueError as error:
        if isinstance(error, InputError):
            raise
        raise DatasetError(
            place,
            f"expected the numbers of a 3x4 or 4x4 matrix, found '{line}'",
            "correct the line",
        ) from error


def format_tum(labels: Sequence[str], poses: np.ndarray) -> str:
    """Formats a TUM trajectory of poses (N, 4, 4) to the world, each with its time or name."""
    quaternions = quaternion_from_rotation(np.reshape(poses, (-1, 4, 4))[:, :3, :3])
    rows = ["# timestamp tx ty tz qx qy qz qw"]
    for label, pose, (w, *xyz) in zip(labels, poses, quaternions, strict=True):
        numbers = " ".join(repr(float(v)) for v in (*pose[:3, 3], *xyz, w))
        rows.append(f"{label} {numbers}")
    return "\n".join(rows) + "\n"
