"""Exports of scanning apps for phones with LiDAR: one table, one reader.

polycam        keyframes/images, cameras (or corrected_images, corrected_cameras): t_00 ... t_23, fx
               fy cx cy; keyframes/depth in millimetres, keyframes/confidence: 0, 54, 255
record3d       rgb, depth/*.exr in metres, metadata.json: K by columns, poses qx qy qz qw tx ty tz;
               or the same in an archive .r3d, depths and confidences packed by LZFSE
3dscannerapp   frame_*.jpg, frame_*.json: cameraPoseARFrame, intrinsics, by rows; depth_*.png in
               millimetres, conf_*.png: 0, 1, 2
strayscanner   rgb, camera_matrix.csv, odometry.csv: time frame x y z qx qy qz qw; depth in
               millimetres, confidence: 0, 1, 2

Poses are camera-to-world in metres, depths z along the camera's axis. Depths of low confidence are
left out.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.data.errors import DatasetError, OnError, list_some, raise_error
from gsut.data.images import read_header
from gsut.data.layouts._layout import Layout
from gsut.data.layouts.folder import POINT_FILES
from gsut.data.listing import Frame, Listing
from gsut.data.poses import OPENGL_FROM_OPENCV, check_rigid, pose_from_quaternion
from gsut.data.recordings import list_pictures
from gsut.data.scene import DepthForm
from gsut.files import (
    open_archive,
    parse_json,
    read_json,
    read_rows,
    reading,
    write_file,
    write_npy,
    write_picture,
)
from gsut.lens import Camera

_ADVICE = "export the scan again, with its raw data"
# Focal lengths and principal point, camera-to-world pose, and size and time where they are given.
_Shot = tuple[list[float], np.ndarray, tuple[int, int] | None, float | None]


@dataclasses.dataclass(frozen=True)
class _App:
    """One app's export.

    Args:
        name, files, rank: see `Layout`.
        inside: the folder in which it lies where that is given, or "".
        marks: patterns of files that are all there.
        pictures: folders of pictures, of which the first that is there is read.
        open: reads what all pictures share; returns a function from a picture to its shot, None
            without a pose.
        depth, confidence: patterns of files; "{}" is the picture's name without "frame_".
        least: level of confidence from which a depth is used.
        is_opengl: whether the camera's axes are OpenGL's; else OpenCV's.
        up: the world's, which ARKit aligns with gravity.
    """

    name: str
    files: str
    rank: int
    inside: str
    marks: tuple[str, ...]
    pictures: tuple[str, ...]
    open: Callable[[Path], Callable[[Path], _Shot | None]]
    depth: str
    confidence: str
    least: int = 1
    is_opengl: bool = True
    up: tuple[float, float, float] | None = (0.0, 1.0, 0.0)


def _find_root(app: _App, path: Path) -> Path | None:
    for root in (path, path / app.inside):
        if root.is_dir() and all(any(root.glob(mark)) for mark in app.marks):
            return root
    return None


def read(app: _App, path: Path, on_error: OnError) -> Listing:
    """Reads an export.

    Args:
        app: whose it is.
        path: the folder.
        on_error: receives each error of a single picture.

    Raises:
        DatasetError: there are no pictures, or what all share is damaged.
    """
    root = _find_root(app, path)
    assert root is not None
    pictures = next(filter(None, (list_pictures(root / name) for name in app.pictures)), [])
    if not pictures:
        raise DatasetError(
            root, f"there are no pictures in {' or '.join(app.pictures)}",
            f"take them out of the film: `ffmpeg -i {root}/rgb.mp4 -fps_mode passthrough "
            f"-start_number 0 {root}/rgb/%06d.jpg`" if (root / "rgb.mp4").is_file()
            else _ADVICE,
        )  # fmt: skip
    listing = Listing(path, root, up=None if app.up is None else np.array(app.up))
    with reading(root, _ADVICE, DatasetError):
        find_shot, without = app.open(root), []
    for picture in pictures:
        try:
            with reading(f"{root}, pose of {picture.name}", _ADVICE, DatasetError):
                shot = find_shot(picture)
            if shot is None:
                without.append(picture.name)
            else:
                listing.frames.append(_make_frame(app, root, path, picture, shot))
        except InputError as error:
            on_error(error)
    if without:
        listing.notes.append(
            f"{root}: {len(without)} of {len(pictures)} pictures have no pose and are left out: "
            f"{list_some(without)}"
        )
    points = next((root / name for name in POINT_FILES if (root / name).is_file()), None)
    if points is not None:
        listing.take_points(points)
    return listing


def _make_frame(app: _App, root: Path, path: Path, picture: Path, shot: _Shot) -> Frame:
    params, pose, size, time = shot
    if size is None:
        header = read_header(picture)
        size = header.width, header.height
    try:
        camera = Camera("pinhole", params, *size)
    except InputError as error:
        raise DatasetError(f"{root}, lens of {picture.name}", str(error), _ADVICE) from error
    files = [_find_beside(root, each, picture) for each in (app.depth, app.confidence)]
    return Frame(
        picture.relative_to(path).as_posix(), picture, camera,
        pose @ OPENGL_FROM_OPENCV if app.is_opengl else pose, depth_path=files[0], time=time,
        depth_form=DepthForm(
            is_z=True, confidence_path=files[1], least_confidence=app.least
        ),
    )  # fmt: skip


def _find_beside(root: Path, pattern: str, picture: Path) -> Path | None:
    return next(root.glob(pattern.format(picture.stem.removeprefix("frame_"))), None)


def _open_polycam(root: Path) -> Callable[[Path], _Shot | None]:
    def find_shot(picture: Path) -> _Shot | None:
        corrected, first = (root / f"{kind}cameras/{picture.stem}.json"
                            for kind in ("corrected_", ""))  # fmt: skip
        file = corrected if corrected.is_file() else first
        if not file.is_file():
            return None
        values = read_json(file)
        matrix = [[values[f"t_{i}{j}"] for j in range(4)] for i in range(3)]
        params = [float(values[key]) for key in ("fx", "fy", "cx", "cy")]
        size = int(values["width"]), int(values["height"])
        return params, check_rigid(matrix, file), size, None

    return find_shot


def _open_scanner(root: Path) -> Callable[[Path], _Shot | None]:
    def find_shot(picture: Path) -> _Shot | None:
        file = picture.with_suffix(".json")
        if not file.is_file():
            return None
        values = read_json(file)
        k = np.reshape(np.array(values["intrinsics"], float), (3, 3))
        pose = check_rigid(np.reshape(values["cameraPoseARFrame"], (4, 4)), file)
        return [k[0, 0], k[1, 1], k[0, 2], k[1, 2]], pose, None, values.get("time")

    return find_shot


def _open_record3d(root: Path) -> Callable[[Path], _Shot | None]:
    file = root / "metadata.json"
    values = read_json(file)
    k = np.reshape(np.array(values["K"], float), (3, 3)).T
    each, poses = values.get("perFrameIntrinsicCoeffs") or [], values["poses"]
    times = values.get("frameTimestamps") or []
    size = (int(values["w"]), int(values["h"])) if "w" in values and "h" in values else None

    def find_shot(picture: Path) -> _Shot | None:
        row = int(picture.stem) if picture.stem.isdecimal() else len(poses)
        if row >= len(poses):
            return None
        x, y, z, w, *place = poses[row]
        pose = pose_from_quaternion((w, x, y, z), place, f"{file}, pose {row}")
        params = each[row][:4] if row < len(each) else [k[0, 0], k[1, 1], k[0, 2], k[1, 2]]
        return [float(v) for v in params], pose, size, times[row] if row < len(times) else None

    return find_shot


def _open_stray(root: Path) -> Callable[[Path], _Shot | None]:
    file = root / "odometry.csv"
    k = np.array([fields for _, fields in read_rows(root / "camera_matrix.csv")], float)
    rows = {}
    for number, fields in read_rows(file)[1:]:  # below the names of the columns
        values = [float(field) for field in fields]
        x, y, z, w = values[5:9]
        pose = pose_from_quaternion((w, x, y, z), values[2:5], f"{file}, line {number}")
        params = values[9:13] if len(values) >= 13 else [k[0, 0], k[1, 1], k[0, 2], k[1, 2]]
        rows[int(values[1])] = params, pose, None, values[0]
    return lambda picture: rows.get(int(picture.stem)) if picture.stem.isdecimal() else None


_APPS = (
    _App(
        "polycam", "keyframes/cameras", rank=60, inside="keyframes",
        marks=("cameras/*.json", "depth"), pictures=("corrected_images", "images"),
        open=_open_polycam, depth="depth/{}.png", confidence="confidence/{}.png", least=54,
    ),
    _App(
        "record3d", "metadata.json", rank=62, inside="EXR_RGBD",
        marks=("metadata.json", "rgb"), pictures=("rgb",), open=_open_record3d,
        depth="depth/{}.*", confidence="conf/{}.png", up=None,
    ),
    _App(
        "3dscannerapp", "frame_00000.json", rank=64, inside="",
        marks=("info.json", "frame_*.json"), pictures=(".",), open=_open_scanner,
        depth="depth_{}.png", confidence="conf_{}.png",
    ),
    _App(
        "strayscanner", "odometry.csv", rank=66, inside="",
        marks=("odometry.csv", "camera_matrix.csv"), pictures=("rgb", "images"), open=_open_stray,
        depth="depth/{}.png", confidence="confidence/{}.png", is_opengl=False,
    ),
)  # fmt: skip


def _make_layout(app: _App) -> Layout:
    return Layout(
        app.name, app.files, app.rank, holds=lambda path: _find_root(app, path) is not None,
        read=functools.partial(read, app),
    )  # fmt: skip


def unpack_record3d(file: Path, folder: Path, **_: Any) -> Listing:
    """Unpacks a .r3d into a folder of Record3D's other export, with depths as .npy.

    Raises:
        DatasetError: the package lzfse is missing, or the archive is damaged.
    """
    try:
        import lzfse
    except ImportError:
        advice = 'install its reader: pip install "gsut[lidar]"; or export EXR + RGB'
        raise DatasetError(file, "its depths are packed by LZFSE", advice) from None
    with reading(file, _ADVICE, DatasetError), open_archive(file, fails=DatasetError) as archive:
        text = archive.read("metadata")
        values = parse_json(text, file)
        shape = int(values["dh"]), int(values["dw"])
        write_file(folder / "metadata.json", text)
        for each in ("rgb", "depth", "conf"):
            (folder / each).mkdir()
        for name in map(Path, archive.names):
            if name.suffix == ".jpg" and name.parent.name == "rgbd":
                write_file(folder / "rgb" / name.name, archive.read(str(name)))
            elif name.suffix in (".depth", ".conf"):
                kind = "<f4" if name.suffix == ".depth" else np.uint8
                unpacked = lzfse.decompress(archive.read(str(name), 8 * shape[0] * shape[1]))
                pixels = np.frombuffer(unpacked, kind).reshape(shape)
                if name.suffix == ".depth":
                    write_npy(folder / "depth" / f"{name.stem}.npy", pixels)
                else:
                    write_picture(folder / "conf" / f"{name.stem}.png", pixels)
    return read(next(app for app in _APPS if app.name == "record3d"), folder, raise_error)


LAYOUTS = (
    *(_make_layout(app) for app in _APPS),
    Layout(
        "r3d", "Record3D's archive", rank=4,
        holds=lambda path: path.is_file() and path.suffix.lower() == ".r3d", unpack=unpack_record3d,
    ),
)  # fmt: skip
