"""Reads a plain folder: images, one lens file, and poses as poses.txt (TUM) or poses.json.

DATA/images/*.jpg   (or the images in DATA itself)
DATA/lens.yaml      (any lens file that `gsut.load_camera` reads)
DATA/poses.txt      lines `name tx ty tz qx qy qz qw`: camera-to-world, OpenCV axes;
                    `name` may also be a time stamp that is the image's file name
DATA/poses.json     or: {"name": 4x4 matrix, camera-to-world, OpenCV axes}
DATA/points3D.ply, DATA/mask.png, DATA/masks/*.png      may be there
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gsut._core import InputError
from gsut.data.assemble import Frame, Listing
from gsut.data.colmap import find_mask
from gsut.data.findings import DatasetError, OnError, some_names, stop
from gsut.data.images import IMAGE_SUFFIXES
from gsut.data.nerfstudio import read_json
from gsut.data.points import load_points_ply
from gsut.data.poses import pose_from_quaternion, rigid_transform
from gsut.lens import load_camera

LENS_PATTERNS = (
    "lens.*", "camera.*", "*.cameramodel", "calibration.*", "*.yaml", "*.yml", "cameras.txt",
)  # fmt: skip
POSE_FILES = ("poses.txt", "poses.json")
POINT_FILES = ("points3D.ply", "points.ply")
_POSE_ADVICE = (
    "`gsut scene` makes a scene of photographs, `gsut poses` finds their poses alone; or write "
    "poses.txt with lines 'name tx ty tz qx qy qz qw' (camera-to-world, OpenCV axes)"
)


def find_lens_file(path: Path) -> Path | None:
    """The lens file of a plain folder, or None."""
    for pattern in LENS_PATTERNS:
        for candidate in sorted(path.glob(pattern)):
            if candidate.is_file() and candidate.suffix.lower() not in IMAGE_SUFFIXES:
                return candidate
    return None


def find_images(path: Path) -> list[Path]:
    """All images below DATA/images, or in DATA itself if that does not exist, sorted."""
    folder = path / "images"
    found = folder.rglob("*") if folder.is_dir() else path.glob("*")
    return sorted(
        p
        for p in found
        if p.suffix.lower() in IMAGE_SUFFIXES and p.is_file() and p != path / "mask.png"
    )


def read_folder(path: Path, *, on_error: OnError = stop) -> Listing:
    """Reads a plain folder; the layout is at the top of this file.

    Args:
        path: the folder.
        on_error: receives each error of a single pose.
    Raises:
        DatasetError: no images, no lens or no poses, or one of these files is broken.
    """
    images = find_images(path)
    if not images:
        raise DatasetError(path, "there are no images", "put PNG or JPEG files into 'images'")
    lens_path = find_lens_file(path)
    if lens_path is None:
        raise DatasetError(
            path,
            f"there is no lens file ({', '.join(LENS_PATTERNS)})",
            f"`gsut scene {path} -o RUN` makes a scene of photographs, `gsut poses` finds lens and "
            "poses alone; a lens file of `gsut calibrate` beside them is used",
        )
    camera = load_camera(lens_path)
    pose_path = next((path / n for n in POSE_FILES if (path / n).is_file()), None)
    if pose_path is None:
        raise DatasetError(
            path, f"{len(images)} images and a lens, but neither of {POSE_FILES}", _POSE_ADVICE
        )
    read = _read_json_poses if pose_path.suffix == ".json" else _read_text_poses
    root = path / "images" if (path / "images").is_dir() else path
    by_alias = _aliases(images, root)
    listing = Listing(path, pose_path)
    mask = path / "mask.png" if (path / "mask.png").is_file() else None
    posed = set()
    for name, make_pose in read(pose_path):
        try:
            pose = make_pose()
        except InputError as error:
            on_error(error)
            continue
        number = _number(name)
        image_path = by_alias.get(name)
        if image_path is None and number is not None:
            image_path = by_alias.get(number)
        if image_path is None:
            listing.missing.append(name)
            continue
        posed.add(image_path)
        image_name = image_path.relative_to(root).as_posix()
        image_mask = find_mask(path / "masks", image_name) or mask
        listing.frames.append(Frame(image_name, image_path, camera, pose, mask_path=image_mask))
    without = [p.relative_to(root).as_posix() for p in images if p not in posed]
    if without:
        listing.notes.append(
            f"{pose_path}: {len(without)} of {len(images)} images have no pose and are left out:"
            f" {some_names(without)}"
        )
    points = next((path / n for n in POINT_FILES if (path / n).is_file()), None)
    if points is not None:
        try:
            listing.points, listing.point_colors = load_points_ply(points, listing.notes)
        except InputError as error:
            on_error(error)
    return listing


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None


def _aliases(images: list[Path], root: Path) -> dict[str | float, Path]:
    """Images by relative path, file name, stem and, for time stamps, number; the first one wins."""
    found: dict[str | float, Path] = {}
    for make in (
        lambda p: p.relative_to(root).as_posix(),
        lambda p: "images/" + p.relative_to(root).as_posix(),
        lambda p: p.name,
        lambda p: p.stem,
        lambda p: _number(p.stem),
    ):
        for image in images:
            alias = make(image)
            if alias is not None:
                found.setdefault(alias, image)
    return found


def _read_text_poses(path: Path):
    """Yields the name and a function that makes the pose, or raises."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except UnicodeDecodeError as error:
        raise DatasetError(path, "not UTF-8 text", "save the file as UTF-8") from error
    for number, line in enumerate(lines, 1):
        line = line.strip()
        if not line or line.startswith("#"):
            continue
        fields, where = line.rsplit(maxsplit=7), f"{path}, line {number}"

        def make_pose(fields=fields, where=where, line=line) -> np.ndarray:
            try:
                values = [float(field) for field in fields[1:]]
                if len(values) != 7:
                    raise ValueError
            except ValueError as error:
                raise DatasetError(
                    where, f"expected 'name tx ty tz qx qy qz qw', found '{line}'", _POSE_ADVICE
                ) from error
            x, y, z, w = values[3:]
            return pose_from_quaternion([w, x, y, z], values[:3], where)

        yield fields[0], make_pose


def _read_json_poses(path: Path):
    values = read_json(path)
    if not isinstance(values, dict):
        raise DatasetError(path, "not an object of names and matrices", _POSE_ADVICE)
    for name, matrix in values.items():
        where = f"{path}, image {name}"
        yield name, lambda matrix=matrix, where=where: rigid_transform(matrix, where)
