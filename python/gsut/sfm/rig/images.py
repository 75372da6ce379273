"""Finds the photographs of a rig, one folder a camera, and the images of each frame."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gsut._core import InputError
from gsut.data import list_some
from gsut.data.rigs import Rig
from gsut.sfm.photographs import (
    FEWEST_IMAGES,
    Features,
    LensGroup,
    Photographs,
    list_photographs,
)

_NOT_CAMERAS = {"masks"}  # folders that may lie beside those of the cameras


def find_rig_photographs(images: Path, rig: Rig) -> Photographs:
    """Finds the images of each camera of a rig, ordered by frame and then by camera.

    Images are of one frame if their names without suffix, and without their camera's name, are
    the same; where no name is in two folders, but all have as many images, they are paired in
    order of their names (numbers by value).

    Args:
        images: folder with one folder a camera, named as in the rig, each with images and masks as
            a plain folder has them (mask.png, masks/); or with such a folder named images.
        rig: see `read_rig`.

    Returns:
        The photographs, with their frames, cameras on the rig, and how they were paired; those of
        each unknown lens are a group.

    Raises:
        InputError: a camera has no folder or no images, a folder is of no camera, or images cannot
            be paired.
    """
    if not images.is_dir():
        raise InputError(f"{images} is not a folder; give the folder with one folder a camera")
    root = images / "images" if (images / "images").is_dir() else images
    names = ", ".join(rig.names)
    absent = [name for name in rig.names if not (root / name).is_dir()]
    if absent:
        there = sorted(p.name for p in root.iterdir() if p.is_dir())
        raise InputError(
            f"{root} has no folder {absent[0]} for a camera of {rig.source} ({names}); folders "
            f"there: {', '.join(there) or 'none'}"
        )
    for folder in sorted(p for p in root.iterdir() if p.is_dir()):
        if folder.name in rig.names or folder.name in _NOT_CAMERAS or folder.name.startswith("."):
            continue
        if len(list_photographs(folder)):
            raise InputError(
                f"{folder} holds images, but {rig.source} has no camera {folder.name}; it has "
                f"{names}: add its lens and pose there, or move the folder away"
            )
    found = [list_photographs(root / name) for name in rig.names]
    for name, each in zip(rig.names, found, strict=True):
        if not len(each):
            raise InputError(f"{root / name} holds no images; a camera of the rig needs some")
    if sum(map(len, found)) < FEWEST_IMAGES:
        raise InputError(f"{root} holds too few images; poses need at least {FEWEST_IMAGES}")
    keys, paired_by = _pair_images([p.names for p in found], rig)
    order = {
        key: i for i, key in enumerate(sorted({k for own in keys for k in own}, key=_split_numbers))
    }
    rows = sorted(
        (order[key], camera, i) for camera, own in enumerate(keys) for i, key in enumerate(own)
    )
    cameras = np.array([camera for _, camera, _ in rows])
    return Photographs(
        root,
        [f"{rig.names[c]}/{found[c].names[i]}" for _, c, i in rows],
        [found[c].paths[i] for _, c, i in rows],
        [found[c].masks[i] for _, c, i in rows],
        [rig.cameras[c] for _, c, _ in rows],
        frames=np.array([frame for frame, _, _ in rows]),
        rig_cameras=cameras,
        paired_by=paired_by,
        groups=tuple(
            LensGroup(rig.names[c], np.flatnonzero(cameras == c)) for c in rig.unknown_lenses
        ),
    )


def require_features(photographs: Photographs, features: Sequence[Features]) -> None:
    """Rejects a rig one of whose cameras has no image with features.

    Raises:
        InputError: there is such a camera; names it.
    """
    cameras = photographs.rig_cameras
    assert cameras is not None
    for camera in range(int(cameras.max()) + 1):
        own = np.flatnonzero(cameras == camera).tolist()
        if any(len(features[image]) for image in own):
            continue
        lens = photographs.cameras[own[0]]
        name = photographs.names[own[0]].split("/")[0]
        size = "" if lens is None else f" ({lens.width} x {lens.height})"
        raise InputError(
            f"none of the {len(own)} images of the camera {name} has features: they are dark, "
            f"without texture, masked, or not of the size of its lens{size}; check them, or leave "
            "the camera out of the rig"
        )


def _pair_images(names: list[list[str]], rig: Rig) -> tuple[list[list[str]], str]:
    """Returns the frame's name of each image of each camera, and "name" or "order"."""
    # The names themselves, else without the camera's name: left/left12.jpg and right/right12.jpg.
    plain = [[str(Path(image).with_suffix("")) for image in own] for own in names]
    short = [
        [key.replace(camera, "") for key in own]
        for own, camera in zip(plain, rig.names, strict=True)
    ]
    for keys in (plain, short):
        if sum(len(set(own)) for own in keys) > len({key for own in keys for key in own}):
            _require_one_each(keys, names, rig)
            return keys, "name"
    counts = {camera: len(own) for camera, own in zip(rig.names, names, strict=True)}
    if len(set(counts.values())) > 1:
        said = ", ".join(f"{camera} {count}" for camera, count in counts.items())
        raise InputError(
            f"images of one frame cannot be found: no name is in two cameras' folders, and their "
            f"numbers differ ({said}); give images of one frame one name, such as "
            f"{rig.names[0]}/0001.png and {rig.names[1]}/0001.png"
        )
    ordered = []
    for own in plain:
        place = {key: i for i, key in enumerate(sorted(own, key=_split_numbers))}
        ordered.append([f"{place[key]}" for key in own])
    return ordered, "order"


def _require_one_each(keys: list[list[str]], names: list[list[str]], rig: Rig) -> None:
    """Rejects two images of one camera at one frame."""
    for own, images, camera in zip(keys, names, rig.names, strict=True):
        twice = sorted(i for i, key in zip(images, own, strict=True) if own.count(key) > 1)
        if twice:
            raise InputError(
                f"images of the camera {camera} are of one frame by their names: "
                f"{list_some(twice)}; each frame has one image of a camera"
            )


def _split_numbers(text: str) -> list[tuple[int, str]]:
    """Returns a key that sorts numbers in names by their value: 2 before 10."""
    return [
        (int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", text)
    ]
