"""A scene made of arrays in memory, without files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from gsut import _core
from gsut._core import InputError
from gsut.bounds import name_wrong_kinds
from gsut.data.points import NO_COLOR
from gsut.data.poses import check_rigid
from gsut.data.scene import TEST_EVERY, Scene, View, split_views
from gsut.lens import Camera

IN_MEMORY = Path("arrays in memory")  # what such a scene has for a dataset's path


@name_wrong_kinds
def scene_from_arrays(
    images: Sequence[np.ndarray],
    cameras: Camera | Sequence[Camera],
    camera_from_world: ArrayLike,
    *,
    points: ArrayLike | None = None,
    point_colors: ArrayLike | None = None,
    masks: Sequence[np.ndarray | None] | None = None,
    names: Sequence[str] | None = None,
    test_every: int = TEST_EVERY,
    test_names: Sequence[str] | None = None,
) -> Scene:
    """Makes a scene of arrays, for `train`, `evaluate` and others; nothing is written.

    Args:
        images: N of (H, W, 3) uint8 RGB; kept, not copied.
        cameras: one for all images, or one for each.
        camera_from_world: (N, 4, 4), OpenCV axes.
        points: (P, 3) to start from, or None: training finds some by stereo.
        point_colors: (P, 3) uint8; mid-grey if None.
        masks: (H, W) bool each, True where pixels count, or None.
        names: of the images; None: 000000, 000001 ...; views are sorted by name.
        test_every: hold out every n-th image by name, 0 for none.
        test_names: names to hold out instead.

    Returns:
        The scene. A command such as `gsut eval` needs files: see `save_dataset`.

    Raises:
        InputError: wrong shapes, types or counts, or a name twice.
        DatasetError: a pose is no rigid transform.
    """
    count = len(images)
    lenses, poses, names = check_counts(count, cameras, camera_from_world, names, masks=masks)
    if len(set(names)) < count:
        raise InputError("two images have the same name; give each its own")
    known = list(dict.fromkeys(lenses))
    views = []
    for i in np.argsort(names, kind="stable"):
        pixels = check_image(images[i], names[i], lenses[i])
        valid = None if masks is None else masks[i]
        if valid is not None:
            valid = _core.read_array(valid, f"mask of {names[i]}") != 0
            if valid.shape != pixels.shape[:2]:
                raise InputError(
                    f"the mask of {names[i]} has shape {valid.shape}, its image {pixels.shape[:2]}"
                )
        pose = check_rigid(poses[i], f"camera_from_world[{i}]")
        views.append(
            View(names[i], IN_MEMORY / names[i], known.index(lenses[i]), pose,
                 pixels=pixels, valid=valid)
        )  # fmt: skip
    train, test, notes = split_views(
        [view.name for view in views], IN_MEMORY, test_every=test_every, test_names=test_names,
        listed_train=None, listed_test=None, missing=[],
    )  # fmt: skip
    xyz, rgb = check_points(points, point_colors)
    return Scene(
        IN_MEMORY, tuple(known), tuple(views), xyz, rgb, tuple(train), tuple(test), np.zeros(3),
        tuple(notes),
    )  # fmt: skip


def check_counts(
    count: int,
    cameras: Camera | Sequence[Camera],
    camera_from_world: ArrayLike,
    names: Sequence[str] | None,
    **others: Sequence | None,
) -> tuple[list[Camera], np.ndarray, list[str]]:
    """Requires one entry for each image of everything that is given.

    Returns:
        Lenses, poses (count, 4, 4) and names, by default numbers of six digits.

    Raises:
        InputError: another number of entries, named.
    """
    lenses = [cameras] * count if isinstance(cameras, Camera) else list(cameras)
    poses = _core.read_array(camera_from_world, "camera_from_world").astype(np.float64)
    names = [f"{i:06d}" for i in range(count)] if names is None else list(names)
    for what, values in {"cameras": lenses, "names": names, **others}.items():
        if values is not None and len(values) != count:
            raise InputError(f"{what} has {len(values)} entries for {count} images")
    if poses.shape != (count, 4, 4):
        raise InputError(f"camera_from_world has shape {poses.shape}, expected ({count}, 4, 4)")
    return lenses, poses, names


def check_image(image: np.ndarray, name: str, camera: Camera) -> np.ndarray:
    """Requires an image of its camera's size, as an array.

    Raises:
        InputError: another shape or type.
    """
    pixels = _core.read_array(image, f"image {name}")
    if pixels.shape != (camera.height, camera.width, 3) or pixels.dtype != np.uint8:
        raise InputError(
            f"image {name} is {pixels.dtype} of shape {pixels.shape}, expected uint8 of "
            f"({camera.height}, {camera.width}, 3), as its camera's"
        )
    return pixels


def check_points(
    points: ArrayLike | None, point_colors: ArrayLike | None
) -> tuple[np.ndarray, np.ndarray]:
    """Requires points (P, 3) as float64, and colours (P, 3) uint8, by default mid-grey.

    Raises:
        InputError: other shapes, or points that are not finite.
    """
    xyz = np.zeros((0, 3))
    if points is not None:
        xyz = _core.read_array(points, "points").astype(np.float64)
    rgb = np.full(xyz.shape, NO_COLOR, np.uint8)
    if point_colors is not None:
        rgb = _core.read_array(point_colors, "point_colors")
    if xyz.ndim != 2 or xyz.shape[1] != 3 or not np.isfinite(xyz).all():
        raise InputError(f"points has shape {xyz.shape}; give (P, 3) finite numbers")
    if rgb.shape != xyz.shape or rgb.dtype != np.uint8:
        raise InputError(
            f"point_colors is {rgb.dtype} of shape {rgb.shape}, expected uint8 of {xyz.shape}"
        )
    return xyz, rgb
