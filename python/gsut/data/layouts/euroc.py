"""EuRoC and TUM-VI: mav0/cam0/data/TIME.png, sensor.yaml or camchain.yaml, poses of the body.

DATA/mav0/cam0/data.csv        times [ns] and file names; without it, names are the times
DATA/mav0/cam0/data/*.png
DATA/mav0/cam0/sensor.yaml     lens and T_BS; else camchain.yaml (T_cam_imu), in DATA, mav0 or dso
DATA/mav0/state_groundtruth_estimate0/data.csv    or vicon0, mocap0; or dso/gt_imu.csv;
                               or a TUM trajectory: groundtruth.txt, trajectory.txt, poses.txt
DATA/mav0/pointcloud0/data.ply may be there
"""

from __future__ import annotations

import functools
import re
from pathlib import Path

import numpy as np

from gsut._core import InputError
from gsut.data.errors import DatasetError, list_some
from gsut.data.export import Export, group_seats, list_losses
from gsut.data.layouts._layout import Layout
from gsut.data.poses import check_rigid
from gsut.data.recordings import Recording, Stream, find_stream, list_pictures
from gsut.data.rigs import BODY, parse_matrix, read_mounts
from gsut.data.text_files import read_rows, read_yaml
from gsut.files import write_file
from gsut.gaussians import quaternion_from_rotation
from gsut.lens.files import format_euroc

ROOT = "mav0"
_CAMERA = re.compile(r"cam\d+$")
_POSE_SENSORS = ("state_groundtruth_estimate0", "vicon0", "mocap0")
_POSE_FILES = (
    "dso/gt_imu.csv", "groundtruth.txt", "trajectory.txt", "poses.txt", "groundtruth.csv",
)  # fmt: skip
_POINTS = ("pointcloud0/data.ply", "points3D.ply", "points.ply")


def _list_camera_folders(root: Path) -> list[Path]:
    """Lists cam0, cam1 ... with pictures in data/ (EuRoC) or right there."""
    if not root.is_dir():
        return []
    return sorted(
        folder
        for folder in root.iterdir()
        if _CAMERA.match(folder.name)
        and folder.is_dir()
        and _find_pictures_folder(folder) is not None
    )


def _find_pictures_folder(folder: Path) -> Path | None:
    return next((f for f in (folder / "data", folder) if f.is_dir() and list_pictures(f)), None)


def _find_root(path: Path) -> Path | None:
    """Finds the folder of cam0, cam1 ...: mav0 in this one, or this one itself."""
    return next((root for root in (path / ROOT, path) if _list_camera_folders(root)), None)


def is_euroc(path: Path) -> bool:
    """Returns whether a folder holds cam0, cam1 ..., or is one of them, then used alone."""
    if not path.is_dir():
        return False
    if _CAMERA.match(path.name) and _find_pictures_folder(path) is not None:
        return True
    return _find_root(path) is not None


def record(path: Path) -> Recording:
    """Records what a folder holds; poses and lenses may be absent."""
    chosen = (path.name,) if _CAMERA.match(path.name) and _find_root(path) is None else ()
    root = path.parent if chosen else _find_root(path) or path
    base = root.parent if root.name == ROOT else root
    folders = _list_camera_folders(root)
    notes: list[str] = []
    streams = [_find_camera_stream(folder, notes) for folder in folders]
    recording = Recording(path, streams, cameras=chosen, names_from=base, notes=notes)
    sensors = {f.name: f / "sensor.yaml" for f in folders if (f / "sensor.yaml").is_file()}
    chains = [
        chain
        for place in dict.fromkeys((root, base, base / "dso"))
        for chain in sorted(place.glob("*camchain*.yaml"))
    ]
    if sensors:
        recording.mounts = functools.partial(read_mounts, sensors)
        if chains:
            recording.notes.append(f"{chains[0]} is not used: the cameras have a sensor.yaml each")
    elif chains:
        recording.mounts = functools.partial(read_mounts, chains[0])
    recording.poses_of = BODY
    if not any("." in text for stream in streams for text in stream.list_times()):
        recording.image_times = "ns"
    recording.points = next((root / n for n in _POINTS if (root / n).is_file()), None) or next(
        (base / n for n in _POINTS if (base / n).is_file()), None
    )
    _find_poses(recording, root, base)
    return recording


def _find_camera_stream(folder: Path, notes: list[str]) -> Stream:
    pictures = _find_pictures_folder(folder) or folder
    table = folder / "data.csv"
    stream = find_stream(folder.name, pictures)
    if stream.mask is None and (folder / "mask.png").is_file():
        stream.mask = folder / "mask.png"
    if not table.is_file():
        return stream
    present = {path.name: path for path in stream.images}
    images, times, absent = [], [], []
    for number, fields in read_rows(table):
        if len(fields) < 2:
            raise DatasetError(
                f"{table}, line {number}",
                f"expected a time [ns] and a file name, found '{' '.join(fields)}'",
                "copy the file again",
            )
        if fields[1] in present:
            times.append(fields[0])
            images.append(present[fields[1]])
        else:
            absent.append(fields[1])
    if not images:
        raise DatasetError(
            table, f"names none of the {len(present)} pictures in {pictures}", "copy both again"
        )
    beside = sorted(present.keys() - {path.name for path in images})
    for names, what in ((absent, "do not exist"), (beside, "are not in it")):
        if names:
            what = f"{len(names)} pictures {what} and are left out: {list_some(names)}"
            notes.append(f"{table}: {what}")
    stream.images, stream.times = images, times
    return stream


def _find_poses(recording: Recording, root: Path, base: Path) -> None:
    for name in _POSE_SENSORS:
        table = root / name / "data.csv"
        if table.is_file():
            recording.poses, recording.pose_times = table, "ns"
            sensor = root / name / "sensor.yaml"
            values = read_yaml(sensor) if sensor.is_file() else {}
            if "T_BS" in values:
                place = check_rigid(parse_matrix(values["T_BS"]), f"{sensor}, key 'T_BS'")
                recording.body_from_poses = None if np.array_equal(place, np.eye(4)) else place
            return
    for folder in dict.fromkeys((root, base)):
        for name in _POSE_FILES:
            if (folder / name).is_file():
                recording.poses = folder / name
                return


_POSES = "state_groundtruth_estimate0"
_HEADING = (
    "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], "
    "q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []"
)


def write_euroc(folder: Path, export: Export) -> list[str]:
    """Writes the dataset; returns what the layout cannot hold.

    Raises:
        InputError: a lens that Kalibr does not have, or cameras that do not move as one body.
    """
    seats, bodies = group_seats(export.frames, "EuRoC")
    texts = [format_euroc(seat.camera, seat.body_from_camera) for seat in seats]
    root = folder / "mav0"
    for number, (seat, text) in enumerate(zip(seats, texts, strict=True)):
        place = root / f"cam{number}"
        rows = ["#timestamp [ns],filename"]
        for frame, time in zip(seat.frames, seat.times, strict=True):
            name = f"{time}{frame.image_path.suffix.lower()}"
            export.place(frame.image_path, place / "data" / name)
            rows.append(f"{time},{name}")
        if len(set(rows)) != len(rows):
            raise InputError("two images of one camera have the same time; EuRoC names by time")
        write_file(place / "data.csv", "\n".join(rows) + "\n")
        write_file(place / "sensor.yaml", text)
    (root / _POSES).mkdir(parents=True)
    order = sorted(bodies)
    quaternions = quaternion_from_rotation(np.array([bodies[time][:3, :3] for time in order]))
    rows = [_HEADING]
    for time, quaternion in zip(order, quaternions, strict=True):
        values = (*bodies[time][:3, 3], *quaternion)
        rows.append(f"{time}," + ",".join(repr(float(v)) for v in values))
    write_file(root / _POSES / "data.csv", "\n".join(rows) + "\n")
    export.write_points(root / "pointcloud0" / "data.ply")
    return list_losses(export, "EuRoC", times=True, lens_limits=False)


LAYOUT = Layout(
    "euroc",
    "mav0/cam0 ... (EuRoC, TUM-VI)",
    rank=30,
    holds=is_euroc,
    record=record,
    write=write_euroc,
)
