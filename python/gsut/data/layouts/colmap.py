"""Reads COLMAP models: cameras, images and points3D as binary or text, with images and masks.

Layout: https://colmap.github.io/format.html. Poses are camera-from-world with OpenCV axes,
quaternions w, x, y, z; the centre of the first pixel is (0.5, 0.5).
"""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

import numpy as np

from gsut._core import InputError
from gsut.data.colmap import (
    ColmapImage,
    ColmapModel,
    RigPlace,
    format_model_binaries,
    hold_rigs,
    read_frames,
    read_images,
    read_points,
    read_rigs,
)
from gsut.data.errors import DatasetError, OnError, list_some, raise_error
from gsut.data.export import Export, list_losses, place_images
from gsut.data.images import (
    MaskLookup,
    PictureLookup,
    find_common_mask,
    find_mask_folder,
    find_named,
    list_picture_names,
)
from gsut.data.layouts._layout import Layout
from gsut.data.layouts.folder import POINT_FILES, POSE_FILES
from gsut.data.listing import Frame, Listing
from gsut.data.points import load_points
from gsut.data.poses import invert_pose, pose_from_quaternion
from gsut.files import read_bytes, read_text, write_file
from gsut.lens import Camera
from gsut.lens.files import camera_from_colmap, list_binary_cameras, list_text_cameras

MODEL_FOLDERS = ("sparse/0", "sparse", ".")
IMAGE_FOLDERS = ("images", "images_2", "images_4", "images_8", ".")
_SUFFIXES = (".bin", ".txt")
_DEEPEST = 3  # folders below the dataset's in which a model is looked for, as in dense/0/sparse
_LOOKED_UP = 100  # names of images by which the folder of pictures is chosen


def find_model(path: Path) -> Path | None:
    """Finds the folder with cameras and images (.bin or .txt): sparse/0, sparse, or this one."""
    for name in MODEL_FOLDERS:
        folder = find_named(path, name)
        if folder is not None and _find_suffix(folder) is not None:
            return folder
    return None


def _find_suffix(folder: Path) -> str | None:
    for suffix in _SUFFIXES:
        if all((folder / f"{stem}{suffix}").is_file() for stem in ("cameras", "images")):
            return suffix
    return None


def _find_models_below(path: Path) -> list[Path]:
    """Finds models in other folders, such as dense/0/sparse, of what is no dataset otherwise."""
    if not path.is_dir() or find_model(path) or find_named(path, *POSE_FILES):
        return []
    patterns = ["*/" * deep + "cameras.*" for deep in range(1, 1 + _DEEPEST)]
    folders = dict.fromkeys(file.parent for each in patterns for file in sorted(path.glob(each)))
    return [folder for folder in folders if _find_suffix(folder) is not None]


def _read_below(path: Path, on_error: OnError) -> Listing:
    models = _find_models_below(path)
    if len(models) > 1:
        names = list_some([model.relative_to(path).as_posix() for model in models])
        raise DatasetError(
            path, f"it holds {len(models)} COLMAP models: {names}",
            "move the one to use to sparse/0, beside the images",
        )  # fmt: skip
    listing = read_colmap(path, model=models[0], on_error=on_error)
    listing.notes.append(f"{models[0]}: the model is read from here")
    return listing


def read_colmap(
    path: Path, *, model: Path | None = None, on_error: OnError = raise_error
) -> Listing:
    """Reads a COLMAP model and finds its images and masks.

    Args:
        path: the dataset (with sparse/0 and images), or the model's own folder.
        model: the model's folder; None: it is looked for.
        on_error: receives each error of a single camera or image.
    Raises:
        DatasetError: a file is truncated or malformed.
    """
    model = find_model(path) if model is None else model
    if model is None:
        raise DatasetError(
            path,
            "no COLMAP model: cameras and images (.bin or .txt) in sparse/0, sparse or the folder",
            "give the folder that holds 'sparse' and 'images'",
        )
    suffix = ".bin" if (model / "images.bin").is_file() else ".txt"
    source = model / f"images{suffix}"
    image_rows = read_images(source)
    cameras, unusable = _read_cameras(model / f"cameras{suffix}", on_error)
    places = _read_rig_places(model, suffix, on_error)
    folder = _find_image_folder(path, model, [row.name for row in image_rows])
    listing, pictures = Listing(path, source), PictureLookup(folder)
    masks = MaskLookup(find_mask_folder(folder.parent))
    common_mask = find_common_mask(folder, folder.parent)
    for row in image_rows:
        try:
            if row.camera_id in unusable:
                continue
            if row.camera_id not in cameras:
                raise DatasetError(
                    row.where,
                    f"image {row.name} has camera {row.camera_id}, which does not exist",
                    f"cameras{suffix} and images{suffix} are of different models: copy both again",
                )
            image_path = pictures.find(row.name)
            if image_path is None:
                listing.missing.append(row.name)
                continue
            name = _name_below(folder, image_path, row.name)
            pose = pose_from_quaternion(
                row.quat_wxyz, row.translation, f"{row.where}, image {row.name}"
            )
            mask = masks.find(name) or common_mask
            lens, place = cameras[row.camera_id], places.get(row.image_id)
            listing.frames.append(
                Frame(name, image_path, lens, invert_pose(pose), mask_path=mask, rig=place)
            )
        except InputError as error:
            on_error(error)
    try:
        listing.points, listing.point_colors = read_model_points(model)
        listing.points_source = _find_points_file(model)
        beside = find_named(path, *POINT_FILES)
        if not len(listing.points) and beside is not None:
            listing.take_points(beside)
    except InputError as error:
        on_error(error)
    listing.notes += pictures.describe_differing(source)
    if folder.name != "images" and listing.frames:
        listing.notes.append(f"{folder}: images are read from here")
    other = _list_other_models(model)
    if other:
        count = len(image_rows)
        what = f"this model of {count} images is used, not {list_some(other)}: give the one to use"
        listing.notes.append(f"{model}: {what}")
    return listing


def _read_cameras(file: Path, on_error: OnError) -> tuple[dict[int, Camera], set[int]]:
    """Reads the lens of each camera; returns them by id, and the ids of those that have none."""
    if file.suffix == ".bin":
        rows = list_binary_cameras(read_bytes(file), str(file))
    else:
        rows = list_text_cameras(read_text(file), str(file))
    cameras: dict[int, Camera] = {}
    unusable: set[int] = set()
    for camera_row in rows:
        try:
            if not np.isfinite(camera_row.params).all():
                raise DatasetError(
                    camera_row.where,
                    f"the parameters of camera {camera_row.camera_id} are not finite",
                    "calibrate again",
                )
            cameras[camera_row.camera_id] = camera_from_colmap(
                camera_row.model,
                camera_row.params,
                camera_row.width,
                camera_row.height,
                source=camera_row.where,
            )
        except InputError as error:
            unusable.add(camera_row.camera_id)
            on_error(error)
    return cameras, unusable


def _read_rig_places(model: Path, suffix: str, on_error: OnError) -> dict[int, RigPlace]:
    """Reads where each image was taken on a rig of several cameras.

    Args:
        model: folder of the model; those of COLMAP 3 have no rigs.
        suffix: of its files.
        on_error: receives an error of the rigs.
    """
    files = [model / f"{stem}{suffix}" for stem in ("rigs", "frames")]
    found: dict[int, RigPlace] = {}
    if not all(file.is_file() for file in files):
        return found
    try:
        rigs = {row.rig_id: row for row in read_rigs(files[0])}
        for frame in read_frames(files[1]):
            rig = rigs.get(frame.rig_id)
            if rig is None:
                raise DatasetError(
                    frame.where, f"its rig, {frame.rig_id}, is not in {files[0].name}",
                    f"{files[0].name} and {files[1].name} are of different models: copy both again",
                )  # fmt: skip
            if len(rig.cameras) < 2:
                continue
            for camera, image in frame.images:
                if rig.cameras.get(camera) is not None:
                    place = list(rig.cameras).index(camera)
                    found[image] = RigPlace(rig.rig_id, place, frame.frame_id)
    except InputError as error:
        on_error(error)
    return found


def _name_below(folder: Path, path: Path, name: str) -> str:
    """Returns a picture's path below a folder; its given name if it lies elsewhere."""
    return path.relative_to(folder).as_posix() if path.is_relative_to(folder) else name


def _find_points_file(model: Path) -> Path | None:
    # A PLY or a cloud is what other programs leave there.
    return find_named(model, *(f"points3D{each}" for each in (*_SUFFIXES, ".ply", ".las", ".laz")))


def read_model_points(model: Path) -> tuple[np.ndarray, np.ndarray]:
    """Reads points3D of a model: (N, 3) float64 and (N, 3) uint8; empty without a file."""
    file = _find_points_file(model)
    if file is None:
        return np.zeros((0, 3)), np.zeros((0, 3), np.uint8)
    return read_points(file) if file.suffix.lower() in _SUFFIXES else load_points(file)


def _find_image_folder(path: Path, model: Path, names: list[str]) -> Path:
    """Finds the folder that holds most of the images; of several, that of the full size."""
    roots = list(dict.fromkeys([path, model.parent, model.parent.parent]))
    found = [find_named(root, name) for root in roots for name in IMAGE_FOLDERS]
    folders = [folder for folder in found if folder is not None and folder.is_dir()]

    def count(folder: Path) -> int:
        return sum(os.path.isfile(folder / name) for name in names[:_LOOKED_UP])

    best = max(folders, key=count)
    if not count(best):
        below = {path / name for name in list_picture_names(path)}
        above = dict.fromkeys(each for file in sorted(below) for each in file.parents)
        best = max([best, *(each for each in above if each.is_relative_to(path))], key=count)
    return best


def _list_other_models(model: Path) -> list[str]:
    """Lists the other models, which COLMAP writes when it could not join all images."""
    found = []
    for folder in sorted(model.parent.iterdir()) if model.name == "0" else ():
        if folder.name.isdigit() and folder != model and find_model(folder) == folder:
            suffix = ".bin" if (folder / "images.bin").is_file() else ".txt"
            with contextlib.suppress(InputError):
                count = len(read_images(folder / f"images{suffix}"))
                found.append(f"{model.parent.name}/{folder.name} of {count}")
    return found


MODEL = "sparse/0"


def write_colmap(folder: Path, export: Export) -> list[str]:
    """Writes the dataset with a binary model; returns what the layout cannot hold.

    Raises:
        InputError: COLMAP has no such lens.
    """
    frames = enumerate(export.frames, 1)
    images, notes = hold_rigs(
        [
            ColmapImage(
                n, each.name, each.camera, invert_pose(each.world_from_camera), rig=each.rig
            )
            for n, each in frames
        ]
    )
    files = format_model_binaries(ColmapModel(images, export.points, export.point_colors))
    place_images(export, folder)
    (folder / MODEL).mkdir(parents=True)
    for name, content in files.items():
        write_file(folder / MODEL / name, content)
    return list_losses(export) + notes


LAYOUTS = (
    Layout(
        "colmap",
        "sparse/0/cameras.bin (or .txt) and images",
        rank=40,
        holds=lambda path: path.is_dir() and find_model(path) is not None,
        read=lambda path, on_error: read_colmap(path, on_error=on_error),
        write=write_colmap,
    ),
    Layout(
        "colmap elsewhere",
        "dense/0/sparse ...",
        rank=85,
        holds=lambda path: bool(_find_models_below(path)),
        read=_read_below,
    ),
)
