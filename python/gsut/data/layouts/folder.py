"""A plain folder: images, a lens file, and poses as a TUM trajectory or poses.json.

DATA/images/*.jpg   or the images in DATA itself; of several cameras a folder each, images/cam0 ...
DATA/lens.yaml      any lens file that `gsut.load_camera` reads; of several cameras camchain.yaml or
                    rig.json, which name those folders, or a lens file each, named as they are
DATA/poses.txt      lines `name tx ty tz qx qy qz qw`: camera-to-world, OpenCV axes; `name` may be a
                    time instead. Also trajectory.txt, groundtruth.txt
DATA/poses.json     or: {"name": 4x4 matrix, camera-to-world, OpenCV axes}
DATA/points3D.ply, DATA/mask.png, DATA/masks/*.png      may be there
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Collection
from pathlib import Path

from gsut._core import InputError
from gsut.data.errors import DatasetError, list_some
from gsut.data.images import IMAGE_SUFFIXES, find_mask_folder, find_named
from gsut.data.layouts._layout import Layout, find_foreign_files
from gsut.data.recordings import MASK, Recording, Stream, find_stream, list_pictures
from gsut.data.rigs import is_rig_file, read_mounts
from gsut.files import read_yaml
from gsut.lens import Camera, load_camera

DESCRIPTION = "dataset.yaml"
LENS_PATTERNS = (
    "lens.*", "camera.*", "*.cameramodel", "calibration.*", "camchain*.yaml", "rig.json",
    "*.yaml", "*.yml", "cameras.txt",
)  # fmt: skip
POSE_FILES = (
    "poses.txt", "poses.json", "trajectory.txt", "groundtruth.txt", "poses.csv", "traj.txt",
)  # fmt: skip
POINT_FILES = ("points3D.ply", "points.ply", "points.las", "points.laz")
DEPTH_FOLDERS = ("depth", "depths", "depth_maps")
NO_IMAGES = ("masks", "mask", *DEPTH_FOLDERS)  # folders of pictures that are no photographs
_LENS_ENDINGS = (".lens.json", ".cameramodel", ".yaml", ".yml", ".json")


def find_lens_file(path: Path, without: Collection[Path] = ()) -> Path | None:
    """Finds the lens file of a plain folder, but none of those `without`; None without one.

    Raises:
        DatasetError: several files under any names hold a lens each.
    """
    for pattern in LENS_PATTERNS:
        files = [
            file for file in sorted(path.glob(pattern))
            if file.is_file() and file.suffix.lower() not in IMAGE_SUFFIXES
            and file.name != DESCRIPTION and file not in without
        ]  # fmt: skip
        if len(files) > 1 and pattern.startswith("*"):
            lenses = {file: camera for file in files if (camera := _try_camera(file)) is not None}
            if len(set(lenses.values())) > 1:
                raise DatasetError(
                    path, f"it holds several lenses: {list_some([file.name for file in lenses])}",
                    f"call the one of these pictures lens{files[0].suffix}; pictures of several "
                    "cameras lie in folders that are called as their lens files",
                )  # fmt: skip
            files = [*lenses, *files]
        if files:
            return files[0]
    return None


def _try_camera(file: Path) -> Camera | None:
    """Loads the lens of a file; None where it holds none, or several."""
    try:
        return load_camera(file)
    except InputError:
        return None


def find_lens_files(path: Path) -> dict[str, Path]:
    """Finds the lens file of each camera whose images have a folder; {} if none has its own.

    The file is named as the folder, or stated under `lens` in dataset.yaml.
    """
    root = find_image_folder(path)
    names = {p.relative_to(root).parts[0] for p in find_images(path) if p.parent != root}
    file = path / DESCRIPTION
    stated = read_yaml(file).get("lens") if file.is_file() else None
    beside = {
        name: path / str(stated[name])
        if isinstance(stated, dict) and name in stated
        else _find_lens_of(root, name)
        for name in sorted(names)
    }
    return {name: file for name, file in beside.items() if file is not None}


def find_image_folder(path: Path) -> Path:
    """Finds DATA/images, or DATA if pictures lie there, or the only other folder that has some."""
    images = find_named(path, "images")
    if images is not None and images.is_dir():
        return images
    if not path.is_dir() or list_pictures(path):
        return path
    others = [each for each in path.iterdir() if each.is_dir() and each.name not in NO_IMAGES]
    found = [each for each in others if list_pictures(each)]
    return found[0] if len(found) == 1 else path


def find_images(path: Path) -> list[Path]:
    """Finds all images of a dataset, see `find_image_folder`, sorted."""
    folder = find_image_folder(path)
    return list_pictures(folder, below=folder != path)


def record(path: Path) -> Recording:
    """Records what the folder holds.

    Raises:
        DatasetError: no images, no lens or no poses.
    """
    images = find_images(path)
    if not images:
        raise DatasetError(path, "there are no images", "put PNG or JPEG files into 'images'")
    root = find_image_folder(path)
    own = find_lens_files(path)
    lens_path = find_lens_file(path, without=own.values())
    foreign = find_foreign_files(path)
    if lens_path is None and not own:
        raise DatasetError(
            path,
            foreign or f"there is no lens file ({', '.join(LENS_PATTERNS)})",
            f"`gsut scene {path} -o RUN` makes a scene of photographs, `gsut poses` finds lens and "
            "poses alone; a lens file of `gsut calibrate` beside them is used",
        )
    poses = find_named(path, *POSE_FILES)
    if poses is None:
        raise DatasetError(
            path,
            foreign or f"{len(images)} images and a lens, but neither of {POSE_FILES[:2]}",
            "`gsut scene` makes a scene of photographs, `gsut poses` finds their poses alone; or "
            "give a TUM trajectory: poses.txt (or trajectory.txt) with lines 'name tx ty tz "
            "qx qy qz qw' (camera-to-world, OpenCV axes)",
        )
    streams, lens = _list_streams(root, images, lens_path, own)
    mask = path / MASK
    if mask.is_file():
        for stream in streams:
            stream.mask = stream.mask or mask
    return Recording(
        path, streams, functools.partial(read_mounts, lens), poses, names_from=root,
        points=find_named(path, *POINT_FILES), masks=find_mask_folder(path),
    )  # fmt: skip


def _list_streams(
    root: Path, images: list[Path], lens_path: Path | None, own: dict[str, Path]
) -> tuple[list[Stream], Path | dict[str, Path]]:
    """Lists one stream, or one a folder if lens files name the folders of the images.

    Raises:
        DatasetError: some of the pictures have a lens file of their own, and others none.
    """
    below: dict[str, list[Path]] = {}
    for path in images:
        below.setdefault(path.relative_to(root).parts[0] if path.parent != root else "", []).append(
            path
        )
    is_rig = "" not in below and lens_path is not None and _is_rig(lens_path)
    if lens_path is not None and not own and not is_rig:
        return [Stream("", images)], lens_path
    without = [name for name in below if name not in own]
    if without and not is_rig:
        name, file = next(iter(own.items()))
        raise DatasetError(
            root, f"the pictures of {name} have a lens file, {file.name}, and those of "
            f"{without[0] or 'the folder itself'} have none",
            "give each folder of pictures its own, or remove it and keep one for all",
        )  # fmt: skip
    streams = [
        dataclasses.replace(find_stream(name, root / name), images=found)
        for name, found in below.items()
    ]
    return streams, lens_path if is_rig and lens_path is not None else own


def _is_rig(lens_path: Path) -> bool:
    try:
        return is_rig_file(lens_path)
    except InputError:
        return False  # read again as a lens file, which says what is wrong


def _find_lens_of(root: Path, name: str) -> Path | None:
    """Finds NAME.yaml or the like, beside the folder of the images or above it."""
    places = (root, root.parent) if root.name == "images" else (root,)
    files = (place / f"{name}{ending}" for place in places for ending in _LENS_ENDINGS)
    return next((file for file in files if file.is_file()), None)


LAYOUTS = (
    Layout(
        "folder",
        "images beside a lens file and poses",
        rank=90,
        holds=lambda path: path.is_dir() and bool(find_images(path)),
        record=record,
    ),
)
