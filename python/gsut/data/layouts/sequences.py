"""Sequences of robotics (EuRoC, TUM-VI, KITTI odometry, TUM RGB-D): one table, one reader.

euroc  DATA/mav0/cam0/data/*.png   named by time in ns; mav0/cam0/data.csv lists time and name
       mav0/cam0/sensor.yaml       lens and T_BS; else camchain.yaml (T_cam_imu) in DATA, mav0, dso
       mav0/state_groundtruth_estimate0/data.csv, or vicon0, mocap0; dso/gt_imu.csv; or a
       trajectory; mav0/pointcloud0/data.ply may be there
kitti  DATA/image_2/000000.png     DATA is .../sequences/NN, or holds one such folder
       calib.txt, times.txt        and ../../poses/NN.txt: 12 numbers a line, of camera 0
tum    DATA/rgb.txt, depth.txt     lines `time rgb/FILE`; or associations.txt, `time rgb/FILE time
       groundtruth.txt             depth/FILE`; a lens file beside them: TUM's own sets have none;
                                   depths are z, 5000 levels a metre
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from gsut._core import InputError
from gsut.data.errors import DatasetError, list_some
from gsut.data.images import read_header
from gsut.data.layouts._layout import Layout
from gsut.data.layouts.folder import POINT_FILES, find_lens_file
from gsut.data.poses import NANOSECONDS, check_rigid, guess_unit, is_time, to_nanoseconds
from gsut.data.recordings import (
    MASK,
    TIME_TOLERANCE,
    Recording,
    Stream,
    find_stream,
    list_pictures,
)
from gsut.data.rigs import BODY, Mount, parse_matrix, read_mounts
from gsut.data.scene import DepthForm
from gsut.files import read_rows, read_text, read_yaml
from gsut.lens import Camera
from gsut.lens.files import FROM_ZERO

_TRAJECTORIES = ("groundtruth.txt", "trajectory.txt", "poses.txt")
_TIME_AND_FILE = 2  # fields of a list
_DEPTH_LEVELS = 5000  # of TUM's depth pictures in a metre


@dataclasses.dataclass(frozen=True)
class _Kind:
    """One way to lay out a sequence.

    Args:
        name, files, rank: see `Layout`.
        poses: files of poses; "{}" is the sequence's name, and "../" the folder above.
        points: files of points.
        mount: finds the lenses, with notes; `mount(root, streams, notes)`.
        inside: where a sequence may lie below the folder that is given.
        cameras: pattern of the cameras' folders; None: one camera, whose pictures a mark lists.
        marks: files of which one must be there; none: the cameras' folders suffice.
        preferred: cameras that are used where they are there.
        listing: file in a camera's folder that lists times and pictures, or "".
        times: file that lists times alone, one a picture, or "".
        unit: of times without a point.
        poses_of: see `Recording`.
    """

    name: str
    files: str
    rank: int
    poses: tuple[str, ...]
    points: tuple[str, ...]
    mount: Callable[[Path, list[Stream], list[str]], Callable | None]
    inside: str | None = None
    cameras: str | None = None
    marks: tuple[str, ...] = ()
    preferred: tuple[str, ...] = ()
    listing: str = ""
    times: str = ""
    unit: str | None = None
    poses_of: str | None = None


def _list_cameras(kind: _Kind, root: Path) -> dict[str, Path]:
    """Lists the cameras' folders of pictures: cam0/data (EuRoC) or cam0 itself."""
    if kind.cameras is None or not root.is_dir():
        return {}
    named = sorted(p for p in root.iterdir() if re.fullmatch(kind.cameras, p.name) and p.is_dir())
    found = {p.name: next(filter(list_pictures, (p / "data", p)), None) for p in named}
    return {name: folder for name, folder in found.items() if folder is not None}


def _is_root(kind: _Kind, folder: Path) -> bool:
    if kind.marks and not any((folder / name).is_file() for name in kind.marks):
        return False
    return kind.cameras is None or bool(_list_cameras(kind, folder))


def _find_roots(kind: _Kind, path: Path) -> tuple[list[Path], tuple[str, ...]]:
    """Finds the folders of sequences here, and the camera whose own folder `path` is."""
    if not path.is_dir():
        return [], ()
    if _is_root(kind, path):
        return [path], ()
    if kind.inside and (found := [f for f in path.glob(kind.inside) if _is_root(kind, f)]):
        return sorted(found), ()
    is_camera = bool(kind.cameras and re.fullmatch(kind.cameras, path.name))
    return ([path.parent], (path.name,)) if is_camera and _is_root(kind, path.parent) else ([], ())


def record(kind: _Kind, path: Path) -> Recording:
    """Records what a folder holds; poses and lenses may be absent."""
    roots, chosen = _find_roots(kind, path)
    if len(roots) > 1:
        raise DatasetError(
            path, f"it holds {len(roots)} sequences: {list_some([root.name for root in roots])}",
            f"give one of them, such as {roots[0]}",
        )  # fmt: skip
    root, notes = roots[0], list[str]()
    base = root.parent if kind.inside == root.name else root
    folders = _list_cameras(kind, root)
    streams = [_read_camera(kind, root, name, place, notes) for name, place in folders.items()]
    if kind.cameras is None:
        table = next(root / name for name in kind.marks if (root / name).is_file())
        streams = [_read_list(table, root, Stream("", []), notes)]
        _add_depths(table, root, streams[0], notes)
    preferred = tuple(name for name in kind.preferred if name in folders)
    if not chosen and 0 < len(preferred) < len(folders):
        notes.append(f"{root}: the colour cameras {', '.join(preferred)} are used")
    recording = Recording(
        path, streams, kind.mount(root, streams, notes), poses_of=kind.poses_of,
        names_from=base, cameras=chosen or preferred, notes=notes,
    )  # fmt: skip
    if not any("." in text for stream in streams for text in stream.list_times()):
        recording.image_times = kind.unit
    recording.points = next(_find_files(root, base, kind.points), None)
    recording.poses = next(_find_files(root, base, kind.poses), None)
    if recording.poses is not None and recording.poses.name == "data.csv":
        recording.pose_times = kind.unit
        sensor = recording.poses.with_name("sensor.yaml")
        values = read_yaml(sensor) if sensor.is_file() else {}
        if "T_BS" in values:
            place = check_rigid(parse_matrix(values["T_BS"]), f"{sensor}, key 'T_BS'")
            recording.body_from_poses = None if np.array_equal(place, np.eye(4)) else place
    return recording


def _find_files(root: Path, base: Path, names: Sequence[str]) -> Iterator[Path]:
    """Finds files by their names from the root, then from the folder above it."""
    for folder in dict.fromkeys((root, base)):
        for name in names:
            place, rest = folder, name.format(root.name)
            while rest.startswith("../"):
                place, rest = place.parent, rest[3:]
            if (place / rest).is_file():
                yield place / rest


def _read_camera(kind: _Kind, root: Path, name: str, pictures: Path, notes: list[str]) -> Stream:
    stream = find_stream(name, pictures)
    if stream.mask is None and (root / name / MASK).is_file():
        stream.mask = root / name / MASK
    table, file = root / name / kind.listing, root / kind.times
    if table.is_file():
        return _read_list(table, pictures, stream, notes)
    if file.is_file():
        texts = read_text(file).split()
        if len(texts) < len(stream.images):
            raise DatasetError(
                file, f"it has {len(texts)} times for {len(stream.images)} pictures of {name}",
                "copy the file again",
            )  # fmt: skip
        stream.times = texts[: len(stream.images)]
    return stream


def _read_list(table: Path, folder: Path, stream: Stream, notes: list[str]) -> Stream:
    """Reads times and names, from `folder`, of a camera's colour pictures."""
    listed = {path.name for path in stream.images}
    images, times, absent = [], [], []
    for number, fields in read_rows(table):
        pairs = [fields[i : i + _TIME_AND_FILE] for i in range(0, len(fields), _TIME_AND_FILE)]
        colour = [p for p in pairs if len(p) == _TIME_AND_FILE and not p[1].startswith("depth")]
        if not colour:
            raise DatasetError(
                f"{table}, line {number}",
                f"expected 'time {'FILE' if listed else 'rgb/FILE'}', found '{' '.join(fields)}'",
                "correct the line, or copy the file again",
            )
        time, name = colour[0]
        if (folder / name).is_file():
            images.append(folder / name)
            times.append(time)
        else:
            absent.append(name)
    if not images and listed:
        raise DatasetError(
            table, f"names none of the {len(listed)} pictures in {folder}", "copy both again"
        )
    beside = sorted(listed - {path.name for path in images})
    for names, what in ((absent, "do not exist"), (beside, "are not in it")):
        if names:
            what = f"{len(names)} pictures {what} and are left out: {list_some(names)}"
            notes.append(f"{table}: {what}")
    return Stream(stream.name, images, times, stream.mask)


def _add_depths(table: Path, folder: Path, stream: Stream, notes: list[str]) -> None:
    """Adds the depth picture nearest in time to each picture, of the list itself or depth.txt."""
    files = [file for file in (table, table.with_name("depth.txt")) if file.is_file()]
    rows = [fields for file in files for _, fields in read_rows(file)]
    found = [
        (time, folder / name)
        for fields in rows for time, name in itertools.pairwise(fields)
        if name.startswith("depth") and is_time(time) and (folder / name).is_file()
    ]  # fmt: skip
    texts = stream.list_times()
    if not found or not all(texts):
        return
    stamps, times = (
        to_nanoseconds(each, guess_unit(each)) for each in (texts, [t for t, _ in found])
    )
    for image, stamp in zip(stream.images, stamps, strict=True):
        nearest = int(np.argmin(np.abs(times - stamp)))
        if abs(times[nearest] - stamp) <= TIME_TOLERANCE * NANOSECONDS:
            stream.depths[image] = found[nearest][1]
    stream.depth_form = DepthForm(1 / _DEPTH_LEVELS, is_z=True)
    without = [image.name for image in stream.images if image not in stream.depths]
    if without:
        notes.append(f"{table}: {len(without)} pictures have no depth: {list_some(without)}")


def _mount_euroc(root: Path, streams: list[Stream], notes: list[str]) -> Callable | None:
    """Takes a sensor.yaml of each camera, else a camchain of Kalibr."""
    base = root.parent if root.name == "mav0" else root
    sensors = {s.name: root / s.name / "sensor.yaml" for s in streams}
    sensors = {name: file for name, file in sensors.items() if file.is_file()}
    places = dict.fromkeys((root, base, base / "dso"))
    chains = [chain for place in places for chain in sorted(place.glob("*camchain*.yaml"))]
    if sensors and chains:
        notes.append(f"{chains[0]} is not used: the cameras have a sensor.yaml each")
    if sensors:
        return functools.partial(read_mounts, sensors)
    return functools.partial(read_mounts, chains[0]) if chains else None


def _mount_tum(root: Path, streams: list[Stream], notes: list[str]) -> Callable | None:
    lens = find_lens_file(root)
    return None if lens is None else functools.partial(read_mounts, lens)


def _mount_kitti(root: Path, streams: list[Stream], notes: list[str]) -> Callable | None:
    """Takes the rectified cameras of calib.txt: P = K [I | t], from camera 0."""
    first = {stream.name: stream.images[0] for stream in streams}
    return lambda names: {
        name: _read_kitti(root / "calib.txt", name, first[name]) for name in names
    }


def _read_kitti(calib: Path, name: str, picture: Path) -> Mount:
    key = f"P{name[-1]}"
    lines = read_text(calib).splitlines()
    found = [(n, line) for n, line in enumerate(lines, 1) if line.split(":")[0].strip() == key]
    if not found:
        raise DatasetError(calib, f"there is no '{key}:', the camera of {name}", "copy it again")
    number, line = found[0]
    where = f"{calib}, line {number}"
    try:
        matrix = np.reshape([float(v) for v in line.split(":", 1)[1].split()], (3, 4))
    except ValueError as error:
        raise DatasetError(
            where, f"expected '{key}:' and 12 numbers, found '{line}'", "copy the file again"
        ) from error
    k = matrix[:, :3]
    if not np.allclose(k, [[k[0, 0], 0, k[0, 2]], [0, k[1, 1], k[1, 2]], [0, 0, 1]], atol=1e-9):
        raise DatasetError(where, f"{key} is not fx 0 cx, 0 fy cy, 0 0 1", "rectify the pictures")
    place = np.eye(4)
    place[:3, 3] = np.linalg.solve(k, matrix[:, 3])
    params = [k[0, 0], k[1, 1], k[0, 2] + FROM_ZERO, k[1, 2] + FROM_ZERO]
    size = read_header(picture)
    try:
        return Mount(Camera("pinhole", params, size.width, size.height), where, from_body=place)
    except InputError as error:
        raise DatasetError(where, str(error), "correct it") from error


_KINDS = (
    _Kind(
        "kitti", "calib.txt and image_0 ...", rank=20,
        inside="sequences/*", cameras=r"image_[0-3]", preferred=("image_2", "image_3"),
        marks=("calib.txt",), times="times.txt", mount=_mount_kitti, poses_of=BODY,
        poses=("../../poses/{}.txt", "poses.txt", "{}.txt", "poses/{}.txt"), points=POINT_FILES,
    ),
    _Kind(
        "euroc", "mav0/cam0 ... (EuRoC, TUM-VI)", rank=30,
        inside="mav0", cameras=r"cam\d+", listing="data.csv", unit="ns", mount=_mount_euroc,
        poses=(
            "state_groundtruth_estimate0/data.csv", "vicon0/data.csv", "mocap0/data.csv",
            "dso/gt_imu.csv", *_TRAJECTORIES, "groundtruth.csv",
        ),
        poses_of=BODY, points=("pointcloud0/data.ply", *POINT_FILES),
    ),
    _Kind(
        "tum", "rgb.txt and groundtruth.txt", rank=50,
        marks=("rgb.txt", "associations.txt", "associate.txt", "associated.txt"),
        mount=_mount_tum, poses=_TRAJECTORIES, points=POINT_FILES,
    ),
)  # fmt: skip


def _make_layout(kind: _Kind) -> Layout:
    return Layout(
        kind.name, kind.files, kind.rank,
        holds=lambda path: bool(_find_roots(kind, path)[0]),
        record=functools.partial(record, kind),
    )  # fmt: skip


LAYOUTS = tuple(_make_layout(kind) for kind in _KINDS)
