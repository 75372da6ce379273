"""From what a reader found in a dataset's files to a Scene: sizes, centring, split."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from gsut._core import InputError
from gsut.data.errors import DatasetError, OnError, list_some, raise_error
from gsut.data.images import (
    IMAGE_SUFFIXES,
    describe_pictures,
    find_mask_folder,
    read_header,
)
from gsut.data.layouts import DEPTH_FOLDERS
from gsut.data.listing import Frame, Listing
from gsut.data.points import find_usable_points
from gsut.data.poses import invert_pose
from gsut.data.scene import HALF_PIXEL, TEST_EVERY, Scene, View, split_views
from gsut.files import split_numbers
from gsut.lens import Camera
from gsut.orientation import count_turns

_PANORAMA_SHAPE = 0.05  # relative difference to twice as wide as high: rows cut off at a pole
SAME_POSE = 1e-9  # relative difference of two poses of a frame that is listed twice


def assemble(
    listing: Listing,
    *,
    test_every: int = TEST_EVERY,
    test_names: Sequence[str] | None = None,
    on_error: OnError = raise_error,
) -> Scene:
    """Checks images against cameras and splits the views.

    Args:
        listing: of one of the readers.
        test_every, test_names: see `split_views`.
        on_error: receives each error of a single frame; the frame is left out if it returns.
    Raises:
        DatasetError: no frame is left, an image has a wrong size, points are not finite.
    """
    notes = list(listing.notes)
    total = len(listing.frames) + len(listing.missing)
    if listing.missing and listing.frames:
        notes.append(
            f"{listing.source}: {len(listing.missing)} of {total} images do not exist and are"
            f" left out: {list_some(listing.missing)}"
        )
    if listing.missing_depth:
        notes.append(
            f"{listing.source}: {len(listing.missing_depth)} depth files do not exist, which "
            f"training does not need: {list_some(listing.missing_depth)}"
        )
    frames = _drop_repeats(listing, notes, on_error)
    frames = _fit_cameras(frames, notes, on_error)
    if not frames:
        raise _explain_nothing_left(listing, total)
    frames.sort(key=lambda frame: split_numbers(frame.name))
    notes += [*_note_masks(listing, frames, on_error), *_note_lenses(frames)]
    notes += _note_unused(listing)
    finite, fault = find_usable_points(listing.points)
    if fault:
        where = listing.points_source or listing.source
        on_error(DatasetError(where, fault, "remove these points"))
    train, test, split_notes = split_views(
        [frame.name for frame in frames],
        listing.source,
        test_every=test_every,
        test_names=test_names,
        listed_train=listing.listed_train,
        listed_test=listing.listed_test,
        missing=[*listing.missing],
    )
    offset = np.mean([frame.world_from_camera[:3, 3] for frame in frames], axis=0)
    cameras, views = _make_views(frames, offset)
    centred = Scene(
        listing.path, tuple(cameras), tuple(views), listing.points[finite] - offset,
        listing.point_colors[finite], tuple(train), tuple(test),
        offset, (*notes, *split_notes), known_up=listing.up,
    )  # fmt: skip
    centred.__dict__["centred"] = centred
    return centred.move_origin((0.0, 0.0, 0.0))


def _note_masks(listing: Listing, frames: list[Frame], on_error: OnError) -> Iterator[str]:
    """Notes masks that belong to no image, and images without a mask among others that have one."""
    used = {frame.mask_path.resolve() for frame in frames if frame.mask_path is not None}
    without = [frame.name for frame in frames if frame.mask_path is None]
    folder = find_mask_folder(listing.path) or listing.path / "masks"
    found = sorted(p for p in folder.rglob("*") if p.suffix.lower() in IMAGE_SUFFIXES)
    idle = [path.relative_to(folder).as_posix() for path in found if path.resolve() not in used]
    named = listing.source.suffix == ".json"  # each frame names its mask
    advice = (
        "name them by 'mask_path'"
        if named
        else f"a mask is called as its image: {folder.name}/{frames[0].name}.png"
    )
    if idle and len(idle) == len(found) and not named:
        what = f"none of {len(found)} masks belongs to an image: {list_some(idle)}"
        on_error(DatasetError(folder, what, f"{advice}; or remove the folder"))
    elif idle:
        yield f"{folder}: {len(idle)} masks are of no image: {list_some(idle)}; {advice}"
    if without and len(without) < len(frames):
        yield (
            f"{len(without)} of {len(frames)} images have no mask and count as a whole"
            f" ({list_some(without)}); {advice}"
        )


def _note_unused(listing: Listing) -> Iterator[str]:
    """Notes clouds and depth files that lie in the dataset's folder and that nothing names."""
    used, files = listing.points_source, sorted(listing.path.glob("*"))
    for file in files:
        if file.suffix.lower() in (".las", ".laz") and file != used:
            yield (
                f"{file} is not used: `gsut align` places a cloud; `ply_file_path` of "
                "transforms.json, or `points` of dataset.yaml, names the one to start from"
            )
        is_folder = file.name.lower() in DEPTH_FOLDERS and file.is_dir()
        if is_folder and all(frame.depth_path is None for frame in listing.frames):
            yield (
                f"{file} is not used: name its files by `depth_file_path` in transforms.json, with "
                "`depth_along` and `depth_unit` (docs/datasets.md)"
            )


def _note_lenses(frames: list[Frame]) -> Iterator[str]:
    """Notes lenses whose coefficients of distortion are all zero."""
    plain: dict[str, int] = {}
    for camera in dict.fromkeys(frame.camera for frame in frames):
        names = camera.param_names.split()
        rows = [i for i, name in enumerate(names) if name[0] in "kp" and name[1:].isdigit()]
        if rows and not np.any(np.asarray(camera.params)[rows]):
            plain[camera.model] = plain.get(camera.model, 0) + 1
    for model, count in plain.items():
        what = "an equidistant fisheye" if model == "kannala_brandt" else "free of it"
        lens = f"the lens ({model}) has" if count == 1 else f"{count} lenses ({model}) have"
        taken, it = ("is taken", "it") if count == 1 else ("are taken", "them")
        yield (
            f"{lens} distortion coefficients that are all 0 and {taken} to be {what}: if the"
            f" photographs are as the camera took them, calibrate {it}"
        )


def _explain_nothing_left(listing: Listing, total: int) -> DatasetError:
    if total == 0:
        return DatasetError(listing.source, "the dataset lists no images", "add images with poses")
    if listing.missing and not listing.frames:
        return DatasetError(
            listing.source,
            f"none of its {total} images exist (looked under {listing.path} for"
            f" {list_some(listing.missing)}; {describe_pictures(listing.path)})",
            "copy the images there or correct the paths",
        )
    return DatasetError(
        listing.source, f"none of its {total} images can be used", "see the other errors"
    )


def _drop_repeats(listing: Listing, notes: list[str], on_error: OnError) -> list[Frame]:
    """Leaves out a frame that repeats an earlier one; the same image with two poses is an error."""
    first: dict[Path, Frame] = {}
    repeated = []
    for frame in listing.frames:
        other = first.setdefault(frame.image_path, frame)
        if other is frame:
            continue
        scale = 1 + np.abs(other.world_from_camera).max()
        if np.abs(frame.world_from_camera - other.world_from_camera).max() > SAME_POSE * scale:
            on_error(
                DatasetError(
                    f"{listing.source}, image {frame.name}",
                    "the image is listed twice with different poses",
                    "remove the wrong one",
                )
            )
        repeated.append(frame.name)
    if repeated:
        notes.append(
            f"{listing.source}: {len(repeated)} images are listed twice and used once:"
            f" {list_some(repeated)}"
        )
    return list(first.values())


def _fit_cameras(frames: list[Frame], notes: list[str], on_error: OnError) -> list[Frame]:
    """Resizes cameras to down-scaled copies of the images; other sizes are errors."""
    fitted, resized = [], []
    for frame in frames:
        try:
            header = read_header(frame.image_path)
            camera = fit_camera(frame.camera, header.width, header.height, frame.image_path)
        except InputError as error:
            on_error(error)
            continue
        if camera is not frame.camera:
            resized.append(frame.name)
            size = (
                f"{frame.camera.width} x {frame.camera.height} to {camera.width} x {camera.height}"
            )
            frame = dataclasses.replace(frame, camera=camera)
        fitted.append(dataclasses.replace(frame, turns=count_turns(header.orientation)))
    if resized:
        notes.append(
            f"{len(resized)} images are scaled copies: their camera was resized from {size}:"
            f" {list_some(resized)}"
        )
    return fitted


def fit_camera(camera: Camera, width: int, height: int, image_path: Path) -> Camera:
    """Resizes a camera to an image of this size, if both axes have the same ratio.

    Raises:
        DatasetError: the shapes differ, or no panorama is as wide for its height.
    """
    if camera.model == "equirectangular" and abs(width / height / 2 - 1) > _PANORAMA_SHAPE:
        raise DatasetError(
            image_path,
            f"the image is {width} x {height} and its camera equirectangular, which sees 360 x 180 "
            "degrees: a panorama is twice as wide as high",
            "name the lens that took it",
        )
    if (width, height) == (camera.width, camera.height):
        return camera
    same_by_width = abs(camera.height * width / camera.width - height) <= HALF_PIXEL
    same_by_height = abs(camera.width * height / camera.height - width) <= HALF_PIXEL
    if same_by_width or same_by_height:
        return camera.resize(width, height)
    turned = (width, height) == (camera.height, camera.width)
    advice = (
        "the image was turned after calibration (EXIF orientation applied?): store it unturned"
        if turned
        else "use the images that the camera was calibrated on, uncropped"
    )
    raise DatasetError(
        image_path,
        f"the image is {width} x {height}, its camera expects {camera.width} x {camera.height}",
        advice,
    )


def _make_views(frames: list[Frame], offset: np.ndarray) -> tuple[list[Camera], list[View]]:
    """Makes views in the recentred world; equal cameras are stored once."""
    cameras: list[Camera] = []
    index_of: dict[tuple, int] = {}
    views = []

    def recenter(world_from_camera: np.ndarray) -> np.ndarray:
        moved = world_from_camera.copy()
        moved[:3, 3] -= offset
        return invert_pose(moved)

    def recenter_if_given(world_from_camera: np.ndarray | None) -> np.ndarray | None:
        return None if world_from_camera is None else recenter(world_from_camera)

    for frame in frames:
        camera = frame.camera
        params = np.asarray(camera.params, np.float64).tobytes()
        key = (camera.model, params, camera.width, camera.height, camera.valid_field_angle)
        if key not in index_of:
            index_of[key] = len(cameras)
            cameras.append(camera)
        views.append(
            View(
                frame.name,
                frame.image_path,
                index_of[key],
                recenter(frame.world_from_camera),
                recenter_if_given(frame.world_from_camera_start),
                recenter_if_given(frame.world_from_camera_end),
                frame.mask_path,
                frame.depth_path,
                frame.shutter,
                turns=frame.turns,
                depth_form=frame.depth_form,
            )
        )
    return cameras, views
