"""Reads nerfstudio / instant-ngp datasets: transforms.json with poses, lens, masks and lists.

Poses are camera-to-world with OpenGL axes. `applied_transform` needs no work here: poses and
`ply_file_path` are both written after it (nerfstudio 1.0 and later); only points of a COLMAP model
beside the file are still in the frame before it. Intrinsics stand for all frames or in a frame, by
nerfstudio's names or, for a lens that it does not know, as `lens_file`: a path beside this file.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from gsut._core import InputError, Shutter
from gsut.data.errors import DatasetError, OnError, list_some, raise_error
from gsut.data.export import POINTS, Export, place_images
from gsut.data.images import PictureLookup, find_named, read_header
from gsut.data.layouts._layout import Layout
from gsut.data.layouts.colmap import find_model, read_model_points
from gsut.data.listing import Frame, Listing
from gsut.data.poses import NANOSECONDS, OPENGL_FROM_OPENCV, average_poses, check_rigid
from gsut.data.scene import MILLIMETRE, DepthForm
from gsut.data.write_nerfstudio import write_transforms
from gsut.files import read_json
from gsut.lens import Camera
from gsut.lens.files import camera_from_nerfstudio, merge_frame_lens

FILE_NAME = "transforms.json"
_PARTS = {part: f"transforms_{part}.json" for part in ("train", "val", "test")}
_LATEST = 1 << 33  # seconds since 1970 or before: whole nanoseconds of them fit 64 bits


def read_nerfstudio(path: Path, *, on_error: OnError = raise_error) -> Listing:
    """Reads transforms.json.

    Args:
        path: the folder or the file.
        on_error: receives each error of a single frame.
    Raises:
        DatasetError: the file is missing, cut off, or its lists and points are broken.
    """
    source = (find_named(path, FILE_NAME) or path / FILE_NAME) if path.is_dir() else path
    values = read_json(source)
    if not isinstance(values, dict) or not isinstance(values.get("frames"), list):
        raise DatasetError(
            source, "there is no list 'frames'", "write one object a frame, as nerfstudio does"
        )
    listing = Listing(source.parent, source)
    pictures, cameras = PictureLookup(listing.path), dict[str, Camera | None]()
    for number, frame in enumerate(values["frames"]):
        try:
            if not isinstance(frame, dict) or not isinstance(frame.get("file_path"), str):
                raise DatasetError(
                    f"{source}, frame {number}", "there is no 'file_path'", "name its image file"
                )
            _read_frame(frame, values, listing, cameras, pictures)
        except InputError as error:
            on_error(error)
    listing.notes += pictures.describe_differing(source)
    listing.notes += _note_what_is_no_use(values, source)
    listing.up = _read_up(values, source)
    listing.listed_train = _read_names(values, "train_filenames", source)
    listing.listed_test = _read_names(values, "test_filenames", source)
    validation = _read_names(values, "val_filenames", source)
    if listing.listed_test is None:
        listing.listed_test = validation
    try:
        _read_points(values, listing)
    except InputError as error:
        on_error(error)
    return listing


def _read_frame(
    frame: dict,
    values: dict,
    listing: Listing,
    cameras: dict[str, Camera | None],
    pictures: PictureLookup,
) -> None:
    name = frame["file_path"]
    where = f"{listing.source}, frame {name}"
    image_path = pictures.find(name)
    if image_path is None:
        listing.missing.append(name)
        return
    camera = _make_frame_camera(frame, values, image_path, listing.source, cameras)
    if camera is None:
        return
    poses = {}
    for key in ("transform_matrix", "transform_matrix_start", "transform_matrix_end"):
        if key in frame:
            opengl = check_rigid(frame[key], f"{where}, {key}")
            poses[key] = opengl @ OPENGL_FROM_OPENCV
    start, end = poses.get("transform_matrix_start"), poses.get("transform_matrix_end")
    middle = poses.get("transform_matrix")
    if (start is None) != (end is None):
        raise DatasetError(
            where,
            "only one of transform_matrix_start and transform_matrix_end is given",
            "give both poses of the rolling shutter, or none",
        )
    if middle is None and start is not None and end is not None:
        middle = average_poses(start, end)
    if middle is None:
        raise DatasetError(where, "there is no 'transform_matrix'", "give its camera-to-world pose")
    nanoseconds = _read_time(frame, "timestamp_ns", NANOSECONDS)
    is_z = "depth_file_path" not in frame and "depth_path" in frame  # instant-ngp's
    listing.frames.append(
        Frame(
            image_path.relative_to(listing.path).as_posix()
            if image_path.is_relative_to(listing.path)
            else name,
            image_path,
            camera,
            middle,
            start,
            end,
            _find_mask(frame, values, listing.path, where),
            _find_geometry(frame, "depth_path" if is_z else "depth_file_path", listing),
            None if start is None else _read_shutter(values | frame, listing.source),
            _read_time(frame, "timestamp"),
            None if nanoseconds is None else int(nanoseconds),
            depth_form=_read_depth_form(values | frame, is_z, listing),
        )
    )


def _read_time(frame: dict, key: str, unit: int = 1) -> float | None:
    """Reads a time, counted in parts of a second; None where there is none, or no such number."""
    value = frame.get(key)
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return None
    return value if abs(value) <= _LATEST * unit else None  # NaN is not


def _note_what_is_no_use(values: dict, source: Path) -> Iterator[str]:
    """Notes times that are none, and a rolling shutter of images whose motion is not given."""
    frames = [frame for frame in values["frames"] if isinstance(frame, dict)]
    for key, unit in (("timestamp", 1), ("timestamp_ns", NANOSECONDS)):
        wrong = [
            str(frame.get("file_path")) for frame in frames
            if frame.get(key) is not None and _read_time(frame, key, unit) is None
        ]  # fmt: skip
        if wrong:
            what = "seconds" if unit == 1 else "nanoseconds"
            yield (
                f"{source}: '{key}' of {len(wrong)} frames is no number of {what} and is left out: "
                f"{list_some(wrong)}"
            )
    still = [
        str(frame.get("file_path")) for frame in frames
        if frame.get("rolling_shutter", values.get("rolling_shutter")) is not None
        and "transform_matrix_start" not in frame
    ]  # fmt: skip
    if still:
        yield (
            f"{source}: 'rolling_shutter' is given, but {len(still)} of {len(frames)} frames have "
            "no transform_matrix_start and transform_matrix_end and count as taken in one moment: "
            f"{list_some(still)}; of a video, --readout-time finds their motion"
        )


def _read_shutter(values: dict, source: Path) -> Shutter:
    """Reads the direction in 'rolling_shutter' of frame or file; top to bottom by default."""
    entry = values.get("rolling_shutter") or {}
    name = entry.get("direction", "top_to_bottom") if isinstance(entry, dict) else entry
    try:
        return Shutter(str(name).lower())
    except InputError as error:
        raise DatasetError(
            source, f"'rolling_shutter': {error}", "write one of these directions"
        ) from error


def _find_mask(frame: dict, values: dict, folder: Path, where: str) -> Path | None:
    name = frame.get("mask_path", values.get("mask_path"))
    if not name:
        return None
    path = find_named(folder, str(name))
    if path is None or not path.is_file():
        raise DatasetError(
            where, f"mask_path '{name}' does not exist", "add the file or drop the key"
        )
    return path


def _find_geometry(frame: dict, key: str, listing: Listing) -> Path | None:
    """Finds a frame's file of depths; notes a missing one, which few trainings need."""
    name = frame.get(key)
    if not name:
        return None
    path = find_named(listing.path, str(name))
    if path is not None and path.is_file():
        return path
    listing.missing_depth.append(str(name))
    return None


def _read_depth_form(values: dict, is_z: bool, listing: Listing) -> DepthForm:
    """Reads how depth files are meant; `values` are those of the file and of a frame."""
    along = values.get("depth_along", "z" if is_z else "ray")
    unit = values.get("depth_unit", values.get("integer_depth_scale", MILLIMETRE))
    if along not in ("z", "ray") or not isinstance(unit, (int, float)) or not 0 < unit < np.inf:
        raise DatasetError(
            listing.source, f"'depth_along' is {along!r} and 'depth_unit' {unit!r}",
            'write "z" or "ray", and the length of a level of a 16-bit picture in world units',
        )  # fmt: skip
    confidence = _find_geometry(values, "confidence_file_path", listing)
    return DepthForm(unit, along == "z", confidence, values.get("least_confidence", 1))


def _make_frame_camera(
    frame: dict, values: dict, image_path: Path, source: Path, cameras: dict[str, Camera | None]
) -> Camera | None:
    """Makes the lens of a frame, whose own keys win over the file's. Equal lenses are made once.

    Returns:
        The camera, or None if making the same lens failed before: it is reported once.
    """
    lens = merge_frame_lens(values, frame, str(source))
    whole = merge_frame_lens(values, {}, str(source))
    where = str(source) if lens == whole else f"{source}, frame {frame['file_path']}"
    if "lens_file" not in lens and ("w" not in lens or "h" not in lens):
        header = read_header(image_path)
        lens.setdefault("w", header.width)
        lens.setdefault("h", header.height)
    key = json.dumps(lens, sort_keys=True)
    if key not in cameras:
        cameras[key] = None
        cameras[key] = camera_from_nerfstudio(lens, where, folder=source.parent)
    return cameras[key]


def _read_up(values: dict, source: Path) -> np.ndarray | None:
    """Reads the direction 'up' in the world, which gsut writes where it is known."""
    if values.get("up") is None:
        return None
    try:
        up = np.array(values["up"], np.float64).reshape(3)
    except (TypeError, ValueError, OverflowError):
        up = np.zeros(3)
    if not np.isfinite(up).all() or not up.any():
        raise DatasetError(source, "'up' is not a direction", "write three numbers, or drop it")
    return up


def _read_names(values: dict, key: str, source: Path) -> list[str] | None:
    names = values.get(key)
    if names is None:
        return None
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise DatasetError(source, f"'{key}' is not a list of names", "write a list of file_path")
    return names


def _read_points(values: dict, listing: Listing) -> None:
    name = values.get("ply_file_path")
    if name:
        path = find_named(listing.path, str(name))
        if path is None or not path.is_file():
            raise DatasetError(
                listing.source,
                f"the points' file '{name}' does not exist",
                "add it, or drop 'ply_file_path' to start from random points",
            )
        listing.take_points(path)
        return
    model = find_model(listing.path / "colmap")
    if model is None or "applied_transform" not in values:
        return
    points, colors = read_model_points(model)
    try:
        transform = np.array(values["applied_transform"], np.float64).reshape(-1, 4)[:3]
        points = points @ transform[:, :3].T + transform[:, 3]
    except (TypeError, ValueError) as error:
        raise DatasetError(
            listing.source, "'applied_transform' is not a 3 x 4 matrix", "correct it"
        ) from error
    listing.points, listing.point_colors = points, colors


def write_nerfstudio(folder: Path, export: Export) -> list[str]:
    """Writes the dataset; returns what the layout cannot hold."""
    frames = place_images(export, folder)
    export.write_points(folder / POINTS)
    write_transforms(
        folder / "transforms.json", frames, points_file=POINTS if len(export.points) else None,
        test=export.test, up=export.up,
    )  # fmt: skip
    losses = []
    if any(frame.depth_path is not None for frame in frames):
        losses.append("depth files are named where they were, not copied")
    if any(frame.rig is not None for frame in frames):
        losses.append("transforms.json has no place for rigs: each image has its own pose")
    return losses


def _read_parts(folder: Path, on_error: OnError) -> Listing:
    """Reads a scene whose training, validation and test images have a file each.

    Training images are trained on, test images held out; validation images where no others are.
    """
    found = {part: find_named(folder, name) for part, name in _PARTS.items()}
    files = {part: file for part, file in found.items() if file is not None}
    held_out = "test" if "test" in files else "val"
    whole = read_nerfstudio(files["train"], on_error=on_error)
    whole.listed_train = [frame.name for frame in whole.frames]
    whole.listed_test = []
    if held_out in files:
        other = read_nerfstudio(files[held_out], on_error=on_error)
        whole.listed_test = [frame.name for frame in other.frames]
        for name in ("frames", "missing", "missing_depth", "notes"):
            getattr(whole, name).extend(getattr(other, name))
    if held_out == "test" and "val" in files:
        whole.notes.append(f"{files['val']}: its images are not used: those of test are held out")
    return whole


LAYOUTS = (
    Layout(
        "nerf-synthetic",
        "transforms_train.json",
        rank=15,
        holds=lambda path: path.is_dir() and find_named(path, _PARTS["train"]) is not None,
        read=_read_parts,
    ),
    Layout(
        "nerfstudio",
        f"{FILE_NAME} (or instant-ngp's)",
        rank=10,
        holds=lambda path: (
            path.suffix.lower() == ".json"
            if path.is_file()
            else find_named(path, FILE_NAME) is not None
        ),
        read=lambda path, on_error: read_nerfstudio(path, on_error=on_error),
        write=write_nerfstudio,
    ),
)
