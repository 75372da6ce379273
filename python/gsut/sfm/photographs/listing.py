"""Finds the photographs that poses are estimated for, and what is known of their lenses."""

from __future__ import annotations

import contextlib
import dataclasses
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsut import _core
from gsut._core import InputError, Shutter
from gsut.data import find_lens_file, find_lens_files, list_some, read_capture, read_dataset
from gsut.data.images import MaskLookup, find_common_mask, find_mask_folder, read_header
from gsut.data.layouts import find_image_folder, find_images, require_pictures
from gsut.lens import Camera, LensProfile, find_lens, find_lenses, is_lens_name, load_camera
from gsut.lens.files import camera_from_values
from gsut.sfm.photographs.moments import read_turns

FEWEST_IMAGES = 2  # that poses, or a point, can be estimated from
# Kannala-Brandt coefficients of a perspective lens: tan(x) / x = 1 + x^2/3 + 2 x^4/15 + ...
TANGENT = (1 / 3, 2 / 15, 17 / 315, 62 / 2835)
FEWEST_OF_MODEL = 4  # that are worth a model of their own: fewer leave their lens open
HELD_BY = 3  # of which any may be wrong or left out, and the others still hold a point, or a doubt
MOST_TRIED = 3  # lenses: each costs a trial reconstruction
SAME_FOCAL = 0.1  # difference of the logarithms of focal lengths of which one is tried


@dataclasses.dataclass(frozen=True)
class LensGroup:
    """Photographs that were taken through one lens, which is unknown.

    Args:
        name: of their camera, such as its folder; "" if there is one camera.
        images: (M,) numbers of the photographs, ascending.
        candidates: lenses that it may be near.
        focal_px: focal length that EXIF states, in pixels.
        focal_sigma: standard deviation of its natural logarithm; None: not known.
    """

    name: str
    images: np.ndarray
    candidates: tuple[Camera, ...] = ()
    focal_px: float | None = None
    focal_sigma: float | None = None


@dataclasses.dataclass(frozen=True)
class Photographs:
    """The photographs that poses are estimated for.

    Args:
        root: the folder that names are relative to.
        names: of the images, sorted.
        paths: of the images.
        masks: one an image, white where pixels are valid, or None.
        cameras: the lens of each image, one object for each lens; None: unknown.
        shutter: rolling, in the dataset's direction; None: the dataset does not say.
        frames: (N,) of a rig: the frame of each image, counted from 0 in order of time.
        rig_cameras: (N,) of a rig: the camera of each image, counted from 0.
        paired_by: of a rig: "name" or "order" of the images.
        profile: the lens of the database that was named: a start, not a known lens.
        candidates: lenses that an unknown one may be near, where there is one.
        times: seconds by name, of a video's frames.
        exif_focal_px: focal length that EXIF states, in pixels.
        flows: (M, 4) by name: pixels of a video's frames, and how far they move in a second.
        orientations: EXIF's by name, 1 for upright; of captures only.
        places: latitude and longitude in degrees, altitude in metres, by name.
        ups: up in the camera's axes by an accelerometer or gimbal, by name.
        sensor_ups: up in the axes of the gyroscope, which poses show, by name.
        focal_sigma: standard deviation of the logarithm of `exif_focal_px`.
        turns: records of a film's turns by source: (N, 4) seconds and rad/s, see `read_turns`.
        groups: the images of each unknown lens, where there are several.
        markers: ids (K,) of each image's markers, whose corners are its first 4 K features.
    """

    root: Path
    names: list[str]
    paths: list[Path]
    masks: list[Path | None]
    cameras: list[Camera | None]
    shutter: Shutter | None = None
    frames: np.ndarray | None = None
    rig_cameras: np.ndarray | None = None
    paired_by: str | None = None
    profile: LensProfile | None = None
    candidates: tuple[Camera, ...] = ()
    times: dict[str, float] = dataclasses.field(default_factory=dict)
    exif_focal_px: float | None = None
    flows: dict[str, np.ndarray] = dataclasses.field(default_factory=dict)
    orientations: dict[str, int] = dataclasses.field(default_factory=dict)
    places: dict[str, tuple[float, float, float]] = dataclasses.field(default_factory=dict)
    ups: dict[str, tuple[float, float, float]] = dataclasses.field(default_factory=dict)
    sensor_ups: dict[str, tuple[float, float, float]] = dataclasses.field(default_factory=dict)
    focal_sigma: float | None = None
    turns: dict[str, np.ndarray] = dataclasses.field(default_factory=dict)
    groups: tuple[LensGroup, ...] = ()
    markers: list[np.ndarray] | None = None

    def __len__(self) -> int:
        return len(self.names)

    @property
    def are_lenses_known(self) -> bool:
        """Whether every image has a lens."""
        return None not in self.cameras

    def select(self, group: LensGroup) -> Photographs:
        """Returns the photographs of one group alone."""
        return dataclasses.replace(
            self,
            names=[self.names[i] for i in group.images],
            paths=[self.paths[i] for i in group.images],
            masks=[self.masks[i] for i in group.images],
            cameras=[self.cameras[i] for i in group.images],
            frames=None,
            rig_cameras=None,
            candidates=group.candidates,
            exif_focal_px=group.focal_px,
            focal_sigma=group.focal_sigma,
            groups=(),
        )

    def with_cameras(self, cameras: Sequence[Camera | None]) -> Photographs:
        """Replaces the lens of each image."""
        return dataclasses.replace(self, cameras=list(cameras))

    @property
    def unknown_groups(self) -> tuple[LensGroup, ...]:
        """The images of each unknown lens."""
        unknown = np.array([i for i, camera in enumerate(self.cameras) if camera is None], int)
        if self.groups or not len(unknown):
            return self.groups
        return (LensGroup("", unknown, self.candidates, self.exif_focal_px, self.focal_sigma),)

    @property
    def lenses(self) -> list[Camera]:
        """The lens of each image; all must be known."""
        assert self.are_lenses_known
        return [camera for camera in self.cameras if camera is not None]


def find_photographs(images: Path, lens: Path | None, *, with_lens: bool = True) -> Photographs:
    """Finds the images of a folder or dataset, and their lens.

    Args:
        images: a folder of images (or with a folder `images`), with masks as `gsut train` reads
            them (mask.png, masks/); or a dataset, whose images, masks and lens are used and whose
            poses are not.
        lens: lens file, or a dataset whose lens is used; None: the one beside the images (of
            several cameras, images/cam0 ..., a file each: cam0.lens.json ...), or unknown. A name
            of the database leaves the lens unknown, with a candidate.
        with_lens: False: the lens is unknown even if files or the dataset state it.

    Raises:
        InputError: no such folder, fewer than two images, or the lens cannot be read.
    """
    require_pictures(images)
    if not images.is_dir():
        raise InputError(f"{images} is not a folder; give the folder of the photographs")
    if (images / "transforms.json").is_file():
        found = _read_dataset_images(images)
    else:
        found = list_photographs(images, with_lens=with_lens and lens is None)
    if lens is not None and is_lens_name(lens):
        found = _add_profile(found, str(lens))
    elif lens is not None or not with_lens:
        camera = None if lens is None else _read_lens(lens)
        groups = () if camera is not None else found.groups
        found = dataclasses.replace(found, cameras=[camera] * len(found), groups=groups)
    if len(found) < FEWEST_IMAGES:
        captured = read_capture(images)
        given = ", ".join(captured["inputs"]) if captured else str(images)
        kinds = "" if captured else _describe_kinds(images)
        raise InputError(
            f"{given} holds {len(found)} image(s){kinds}; poses need at least {FEWEST_IMAGES} that "
            "overlap, better 20 or more"
        )
    return found if found.groups or found.frames is not None else _group_by_folder(found)


def _group_by_folder(found: Photographs) -> Photographs:
    """Takes each folder of images without a lens for a camera of its own.

    A lens that was named is that of all folders.
    """
    folders: dict[str, list[int]] = {}
    for index, (name, camera) in enumerate(zip(found.names, found.cameras, strict=True)):
        if camera is None:
            folders.setdefault(_find_folder(name), []).append(index)
    one_lens = len(folders) == 1 and None in found.cameras and len(set(found.cameras)) == 1
    if found.profile is not None or one_lens or not folders:
        return found
    groups = [
        LensGroup(name, np.array(images), found.candidates, found.exif_focal_px, found.focal_sigma)
        for name, images in folders.items()
    ]
    return dataclasses.replace(found, groups=tuple(groups))


def _describe_kinds(folder: Path) -> str:
    """Describes the files that cannot be read as pictures, such as HEIC beside a given lens."""
    kinds = {path.suffix.lower() for path in folder.rglob("*") if path.is_file()} - {""}
    listed = list_some(sorted(kinds))
    return f" among files of the kinds {listed}" if listed else ""


def _read_dataset_images(path: Path) -> Photographs:
    frames = sorted(read_dataset(path).frames, key=lambda frame: frame.name)
    return Photographs(
        path,
        [frame.name for frame in frames],
        [frame.image_path for frame in frames],
        [frame.mask_path for frame in frames],
        [frame.camera for frame in frames],
        next((frame.shutter for frame in frames if frame.shutter is not None), None),
    )


def list_photographs(path: Path, *, with_lens: bool = False) -> Photographs:
    """Lists the images and masks of a plain folder, and reads the lens beside them if wanted."""
    captured = read_capture(path)
    if captured is not None:
        return _read_captured(path, captured)
    paths = find_images(path)
    root = find_image_folder(path)
    names = [p.relative_to(root).as_posix() for p in paths]
    lookup = MaskLookup(find_mask_folder(path))
    masks = [
        lookup.find(name) or find_common_mask(image.parent, path)
        for name, image in zip(names, paths, strict=True)
    ]
    cameras: list[Camera | None] = [None] * len(names)
    if with_lens:
        cameras = _read_lenses(path, names)
    return Photographs(root, names, paths, masks, cameras)


def _read_lenses(path: Path, names: list[str]) -> list[Camera | None]:
    """Returns the lens of each image of a plain folder: its camera's own, or the one of all.

    Raises:
        InputError: images lie beside the folders of cameras that have a lens file each.
    """
    files = find_lens_files(path)
    if not files:
        file = find_lens_file(path)
        return [None if file is None else load_camera(file)] * len(names)
    alone = next((name for name in names if "/" not in name), None)
    if alone is not None:
        raise InputError(
            f"{alone} lies beside the folders of {path} that have a lens each ("
            f"{', '.join(files)}): move it into the folder of its camera"
        )
    lenses = {name: load_camera(file) for name, file in files.items()}
    return [lenses.get(name.split("/", 1)[0]) for name in names]


def _read_captured(path: Path, captured: dict[str, Any]) -> Photographs:
    """Returns the pictures that capture.json lists, and what they say about their lens."""
    rows, frames, lens_of = _order_rows(captured)
    masks = [row.get("mask") for row in rows]
    return Photographs(
        path,
        [row["name"] for row in rows],
        [path / row["path"] for row in rows],
        [None if mask is None else path / mask for mask in masks],
        [camera_from_values(captured["lens"]) if captured.get("lens") else None] * len(rows),
        frames=frames,
        rig_cameras=lens_of,
        paired_by=None if frames is None else "name",
        candidates=_find_candidates(captured),
        times={row["name"]: row["time"] for row in rows if row.get("time") is not None},
        exif_focal_px=captured.get("focal_px"),
        flows={row["name"]: np.array(row["flow"]) for row in rows if row.get("flow")},
        # The circles of a dual fisheye have an orientation of their own.
        orientations={
            row["name"]: row.get("orientation") or 1 for row in rows if not captured.get("fisheye")
        },
        places={row["name"]: tuple(row["place"]) for row in rows if row.get("place")},
        ups={row["name"]: tuple(row["up"]) for row in rows if row.get("up")},
        sensor_ups={row["name"]: tuple(row["sensor_up"]) for row in rows if row.get("sensor_up")},
        focal_sigma=captured.get("focal_sigma"),
        turns={} if frames is not None else read_turns(path, captured),
        groups=_read_groups(captured, rows),
    )


def _read_groups(captured: dict[str, Any], rows: list[dict[str, Any]]) -> tuple[LensGroup, ...]:
    """Returns the pictures of each camera, zoom and shape, where they are several."""
    of_row = np.array([row.get("camera", 0) for row in rows])
    groups = []
    for number, values in enumerate(captured.get("cameras", ())):
        images = np.flatnonzero(of_row == number)
        folder = _find_folder(rows[images[0]]["name"])
        name = folder or f"{number + 1} {values['camera']}".strip()
        groups.append(
            LensGroup(
                name, images, _find_candidates(values), values["focal_px"], values["focal_sigma"]
            )
        )
    return tuple(groups)


def _find_folder(name: str) -> str:
    """Finds the folder of a photograph's camera by its name; "" if it lies in none."""
    return name.rpartition("/")[0].partition("/")[0]


def _order_rows(
    captured: dict[str, Any],
) -> tuple[list[dict[str, Any]], np.ndarray | None, np.ndarray | None]:
    """Sorts the rows of the pictures; of two lenses it returns each row's frame and lens too."""
    rows = sorted(captured["frames"], key=lambda row: row["name"])
    lenses = captured.get("lenses")
    if not lenses:
        return rows, None, None
    parts = [row["name"].split("/", 1) for row in rows]
    moments = sorted({moment for _, moment in parts})
    keys = [(moments.index(moment), lenses.index(lens)) for lens, moment in parts]
    order = sorted(range(len(rows)), key=keys.__getitem__)
    sorted_keys = np.array([keys[i] for i in order])
    return [rows[i] for i in order], sorted_keys[:, 0], sorted_keys[:, 1]


def _find_candidates(captured: dict[str, Any]) -> tuple[Camera, ...]:
    """Finds the lenses that EXIF and the database suggest for the pictures' camera."""
    width, height = captured["size"]
    found = []
    if captured.get("fisheye"):
        found.append(camera_from_values(captured["fisheye"]))
    focal = captured.get("focal_px")
    if focal:
        params = [focal, focal, width / 2, height / 2, *TANGENT]
        found.append(Camera("kannala_brandt", params, width, height))
    name = captured.get("camera")
    for profile in find_lenses(name, size=(width, height)) if name else ():
        if len(found) > MOST_TRIED:
            break
        lens = profile.make_camera(width, height)
        near = any(abs(math.log(lens.params[0] / c.params[0])) < SAME_FOCAL for c in found)
        if not (profile.doubts or near):
            found.append(lens)
    return tuple(found)


def _add_profile(found: Photographs, name: str) -> Photographs:
    """Adds a lens of the database as a candidate."""
    sizes = []
    for path in found.paths:
        with contextlib.suppress(InputError):  # unreadable: reported when features are sought
            header = read_header(path)
            sizes.append((header.width, header.height))
            break
    profile = find_lens(name, *sizes)
    candidates = tuple(profile.make_camera(*size) for size in sizes)
    return dataclasses.replace(
        found, cameras=[None] * len(found), profile=profile, candidates=candidates, groups=()
    )


def check_lens(lens: str | None) -> None:
    """Raises InputError or OSError, before time is spent, if `--camera` names no lens file."""
    if lens is not None and not is_lens_name(lens):
        _read_lens(Path(lens))


def _read_lens(path: Path) -> Camera:
    if not path.is_dir():
        return load_camera(path)
    if (path / "transforms.json").is_file():
        cameras = {frame.camera for frame in read_dataset(path).frames}
        if len(cameras) != 1:
            raise InputError(f"{path} has {len(cameras)} lenses; give the file of one")
        return cameras.pop()
    file = find_lens_file(path)
    if file is None:
        raise InputError(f"{path} holds neither a transforms.json nor a lens file")
    return load_camera(file)


def require_central(cameras: Iterable[_core.Camera]) -> None:
    """Rejects lenses whose rays do not meet in one point.

    Raises:
        InputError: such a lens; says what to use instead.
    """
    for camera in cameras:
        if not camera.is_central:
            raise InputError(
                f"poses need a lens whose rays meet in one point, and those of {camera.model} do "
                "not: fit a central one to it, such as splined_stereographic, with `gsut camera "
                "convert`"
            )
