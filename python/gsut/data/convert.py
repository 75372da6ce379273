"""Writes datasets for nerfstudio or COLMAP: from any layout, from a run, or from arrays."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gsut._core import InputError
from gsut.bounds import name_wrong_kinds
from gsut.data.assemble import assemble
from gsut.data.errors import DatasetError, raise_error
from gsut.data.export import (
    Export,
    find_frame_times,
    move_file,
    strip_images_folder,
)
from gsut.data.layouts import Layout, describe_recording, find_layout, list_layouts, replace_parts
from gsut.data.listing import Frame, Listing
from gsut.data.load import read_dataset
from gsut.data.memory import check_counts, check_image, check_points
from gsut.data.poses import (
    check_rigid,
    format_seconds,
    format_tum,
    invert_pose,
    move_poses,
    split_similarity,
)
from gsut.data.recordings import Recording, pair_recording
from gsut.data.scene import Scene, split_views
from gsut.files import copy_file, staging_folder, whole_folder, write_file, write_picture
from gsut.lens import Camera, save_camera
from gsut.lens.files import OWN_SUFFIX

_DEFAULT = "nerfstudio"
_PLACES = {"lens", "poses"}  # what replaces those of a dataset
_PNG = ".png"


def list_writable_layouts() -> dict[str, Layout]:
    """Lists the layouts that can be written, by name."""
    return {each.name: each for each in list_layouts() if each.write is not None}


@name_wrong_kinds
def convert_dataset(
    source: str | os.PathLike[str],
    out: str | os.PathLike[str],
    to: str = _DEFAULT,
    *,
    parts: Mapping[str, Any] | None = None,
    poses_topic: str | None = None,
    scene: Scene | None = None,
    cloud: tuple[str | os.PathLike[str], np.ndarray] | None = None,
    progress: bool = False,
) -> list[str]:
    """Writes a dataset in another layout, or its poses alone as a trajectory.

    Args:
        source: a dataset of any layout (docs/datasets.md); a ROS bag, of which without poses a
            folder of pictures and a lens file a camera are written; or a folder of pictures, where
            `parts` say the rest.
        out: a new folder; or, for a trajectory as TUM writes it (camera-to-world, by time where it
            is known, else by name), a file that ends as .txt.
        to: the layout, "nerfstudio" or "colmap".
        parts: what dataset.yaml would say, by its keys: lens, poses, points, cameras and so
            on; relative paths begin at the working directory.
        poses_topic: of a bag's poses, where several are there.
        scene: take poses and lenses from here, by the names of its views.
        cloud: a file of points to take, and the similarity (4, 4) from the dataset's coordinates
            to those of the file, in which the dataset is written.
        progress: show a bar while a bag is read.

    Returns:
        What the layout cannot hold, and what was left out on reading, one sentence each.

    Raises:
        InputError: `out` exists, the layout is unknown, or it cannot hold this lens or rig.
        DatasetError: the dataset is broken.
    """
    source, out = Path(source), Path(out)
    if out.exists():
        raise InputError(f"{out} exists; remove it or name another")
    given = {key: value for key, value in (parts or {}).items() if value is not None}
    layout = find_layout(source) if source.exists() else None
    if layout is None or layout.unpack is None:
        if given and layout is not None and layout.read is not None and not given.keys() >= _PLACES:
            raise DatasetError(
                source, f"'{next(iter(given))}' is given, but its files say which lens and pose "
                "each picture has",
                "leave it out; or give both lens and poses, which replace them",
            )  # fmt: skip
        listing = _read(source, given)
        if cloud is not None:
            _move_into(listing, Path(cloud[0]), cloud[1])
        return _write(listing, out, to, copy_file, scene)
    with staging_folder(out) as staging:
        recording = layout.unpack(
            source, staging, poses_topic="" if given.get("poses") else poses_topic,
            cameras=given.get("cameras", ()), progress=progress,
        )  # fmt: skip
        if isinstance(recording, Listing) and to != _DEFAULT:
            return _write(recording, out, to, move_file, None)
        if isinstance(recording, Listing):  # stays as it is unpacked, with its depths
            with whole_folder(out) as folder:
                for file in filter(Path.is_file, sorted(staging.rglob("*"))):
                    move_file(file, folder / file.relative_to(staging))
            return recording.notes
        recording = replace_parts(recording, _from_here(given), Path.cwd(), source)
        if recording.poses is None:
            return _write_pictures(recording, out)
        return _write(pair_recording(recording, raise_error), out, to, move_file, None)


def _write_pictures(recording: Recording, out: Path) -> list[str]:
    """Writes a folder of pictures a camera, and its lens file where the lens is known."""
    notes = list(recording.notes)
    with whole_folder(out) as folder:
        for stream in recording.streams:
            for image in stream.images:
                move_file(image, folder / "images" / stream.name / image.name)
            try:
                mounts = recording.mounts([stream.name]) if recording.mounts is not None else {}
                save_camera(mounts[stream.name].camera, folder / f"{stream.name}{OWN_SUFFIX}")
            except (InputError, KeyError) as error:
                notes.append(f"{stream.name}: no lens ({error}); it is estimated with the poses")
    notes.append(f"there are no poses: `gsut scene {out} -o SCENE` finds them and makes a scene")
    return notes


def _write(
    listing: Listing,
    out: Path,
    to: str,
    place: Callable[[Path, Path], None],
    scene: Scene | None,
) -> list[str]:
    if scene is not None:
        _take_poses(listing, scene)
    checked = assemble(listing, test_every=0)  # sizes, repeats, images that can be read
    lenses = {view.name: checked.file_cameras[view.camera_index] for view in checked.views}
    found = {frame.name: frame for frame in reversed(listing.frames) if frame.name in lenses}
    frames = [dataclasses.replace(found[name], camera=lenses[name]) for name in sorted(found)]
    notes = list(checked.notes)
    if out.suffix.lower() == ".txt":
        return notes + _write_trajectory(out, frames)
    has_lists = listing.listed_test is not None or listing.listed_train is not None
    held_out = {checked.views[i].name for i in checked.test_indices}
    test = [frame.name for frame in frames if frame.name in held_out] if has_lists else None
    export = Export(
        frames, listing.points, listing.point_colors, test, place, listing.up,
    )  # fmt: skip
    return notes + write_layout(out, export, to)


def _read(source: Path, parts: Mapping[str, Any]) -> Listing:
    if not parts:
        return read_dataset(source)
    values = {"images": str(source.resolve()), **_from_here(parts)}
    return pair_recording(describe_recording(values, source.resolve(), source), raise_error)


def _from_here(parts: Mapping[str, Any]) -> dict[str, Any]:
    """Makes the parts' paths absolute, from the working directory."""
    found, here = dict(parts), Path.cwd()
    for key in ("images", "lens", "poses", "points", "masks"):
        value = found.get(key)
        if isinstance(value, Mapping):
            found[key] = {name: str(here / str(path)) for name, path in value.items()}
        elif value is not None:
            found[key] = str(here / str(value))
    return found


def _take_poses(listing: Listing, scene: Scene) -> None:
    views = {view.name: view for view in scene.views}
    for frame in listing.frames:
        view = views.get(frame.name)
        if view is not None:
            frame.world_from_camera = invert_pose(scene.to_dataset(view.camera_from_world))
            frame.camera = scene.file_cameras[view.camera_index]


def _move_into(listing: Listing, cloud: Path, matrix: np.ndarray) -> None:
    """Moves the poses by a similarity (4, 4) into the frame of a cloud, and takes its points."""
    scale, rotation, shift = split_similarity(matrix)
    for frame in listing.frames:
        for name in ("world_from_camera", "world_from_camera_start", "world_from_camera_end"):
            pose = getattr(frame, name)
            if pose is not None:
                moved = move_poses(invert_pose(pose), scale, rotation, shift)
                setattr(frame, name, invert_pose(moved))
        frame.rig = None
    if any(frame.depth_path is not None for frame in listing.frames):
        listing.notes.append("depth files are left out: they are in the unit of the poses before")
        for frame in listing.frames:
            frame.depth_path = None
    listing.up = None if listing.up is None else rotation @ listing.up
    listing.take_points(cloud)


def _write_trajectory(out: Path, frames: Sequence[Frame]) -> list[str]:
    """Writes poses alone; returns what other readers of the file need and do not find."""
    poses = np.array([frame.world_from_camera for frame in frames])
    times = find_frame_times(frames)
    if times is not None:
        write_file(out, format_tum([format_seconds(time) for time in times], poses))
        return []
    write_file(out, format_tum([strip_images_folder(frame) for frame in frames], poses))
    return [
        f"the pictures have no times: lines of {out.name} begin with names, which gsut reads; "
        "other programs expect seconds there"
    ]


def write_layout(out: Path, export: Export, to: str) -> list[str]:
    """Writes an export to a new folder, which appears only when it is complete.

    Raises:
        InputError: the folder exists, or there is no such layout.
    """
    known = list_writable_layouts()
    if to not in known:
        raise InputError(f"there is no layout '{to}' to write; known: {', '.join(sorted(known))}")
    write = known[to].write
    assert write is not None
    with whole_folder(out) as folder:
        return write(folder, export)


@name_wrong_kinds
def save_dataset(
    out: str | os.PathLike[str],
    images: Sequence[np.ndarray | str | os.PathLike[str]],
    cameras: Camera | Sequence[Camera],
    camera_from_world: ArrayLike,
    *,
    names: Sequence[str] | None = None,
    times_ns: Sequence[int] | None = None,
    masks: Sequence[np.ndarray | None] | None = None,
    points: ArrayLike | None = None,
    point_colors: ArrayLike | None = None,
    test_names: Sequence[str] | None = None,
    to: str = _DEFAULT,
) -> list[str]:
    """Writes arrays as a dataset that every command and `load_dataset` read.

    Args:
        out: a new folder, which appears only when it is complete.
        images: N of (H, W, 3) uint8 RGB, written as PNG, or paths of files, which are copied.
        cameras: one for all images, or one for each.
        camera_from_world: (N, 4, 4), OpenCV axes.
        names: of the images, with folders where wanted; None: 000000, 000001 ...; a name without
            a suffix gets that of its file.
        times_ns: (N,) whole nanoseconds, or None.
        masks: (H, W) bool each, True where pixels count, or None.
        points: (P, 3), in the same world, or None.
        point_colors: (P, 3) uint8; mid-grey if None.
        test_names: of the images held out; None: the reader chooses.
        to: the layout, see `convert_dataset`.

    Returns:
        What the layout cannot hold, one sentence each.

    Raises:
        InputError: wrong shapes or counts, or the folder exists; see `convert_dataset`.
    """
    lenses, poses, names = check_counts(
        len(images), cameras, camera_from_world, names, times_ns=times_ns, masks=masks
    )
    xyz, rgb = check_points(points, point_colors)
    out = Path(out)
    if out.exists():
        raise InputError(f"{out} exists; remove it or name another folder")
    with staging_folder(out) as staging:
        folder, frames = staging, []
        for i, name in enumerate(names):
            path, name = _store_image(images[i], name, lenses[i], folder / f"{i}{_PNG}")
            valid, mask = None if masks is None else masks[i], None
            if valid is not None:
                mask = folder / f"{i}.mask{_PNG}"
                _write_png(mask, np.asarray(valid, bool).astype(np.uint8) * 255)
            frames.append(
                Frame(
                    name, path, lenses[i], invert_pose(check_rigid(poses[i], f"pose {i}")),
                    mask_path=mask, time_ns=None if times_ns is None else int(times_ns[i]),
                )
            )  # fmt: skip
        held_out = None
        if test_names is not None:
            _, rows, _ = split_views([frame.name for frame in frames], out, test_names=test_names)
            held_out = [frames[row].name for row in rows]
        return write_layout(
            out,
            Export(
                frames, xyz, rgb, held_out,
                lambda here, there: (
                    move_file if here.is_relative_to(folder) else copy_file
                )(here, there),
            ),
            to,
        )  # fmt: skip


def _store_image(
    image: np.ndarray | str | os.PathLike[str], name: str, camera: Camera, target: Path
) -> tuple[Path, str]:
    """Stores an array as PNG; returns the picture's file, and its name with a suffix."""
    if isinstance(image, (str, os.PathLike)):
        path = Path(image)
        if not path.is_file():
            raise DatasetError(path, "the image does not exist", "correct the path")
        return path, name if Path(name).suffix else name + path.suffix
    pixels = check_image(image, name, camera)
    _write_png(target, pixels)
    return target, name if Path(name).suffix else name + _PNG


def _write_png(path: Path, pixels: np.ndarray) -> None:
    write_picture(path, pixels[..., ::-1] if pixels.ndim == 3 else pixels)
