"""Leaves out of training what shows the same in all photographs of a camera."""

from __future__ import annotations

import collections
import concurrent.futures
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from gsut import _core
from gsut.data import DatasetError, Scene
from gsut.data.images import (
    COMPARED_SIDE,
    FEWEST_COMPARED,
    describe_fixed_pixels,
    find_fixed_pixels,
    is_shown,
)
from gsut.sampling import choose_evenly

# Radians by which some of the optical axes must differ, so that a sky moves in the pictures.
_LEAST_TURN = math.radians(5)


def find_fixed_of_cameras(scene: Scene) -> tuple[np.ndarray | None, ...]:
    """Finds the pixels of each camera that show the same in all its photographs.

    Photographs with masks or alpha are not looked at: these say what counts. Cameras of few
    photographs are taken together with the others of their size.

    Returns:
        See `Scene.fixed`.
    """
    sizes = [(camera.width, camera.height) for camera in scene.cameras]
    counts = collections.Counter(view.camera_index for view in scene.views)
    groups = collections.defaultdict[Any, list[int]](list)
    for index, view in enumerate(scene.views):
        alone = counts[view.camera_index] >= FEWEST_COMPARED
        groups[view.camera_index if alone else sizes[view.camera_index]].append(index)
    found: list[np.ndarray | None] = [None] * len(sizes)
    for group in groups.values():
        fixed = _find_fixed(scene, group)
        for number in {scene.views[index].camera_index for index in group}:
            if fixed is not None and is_shown(scene.cameras[number], fixed):
                found[number] = fixed
    return tuple(found) if any(each is not None for each in found) else ()


def _find_fixed(scene: Scene, indices: Sequence[int]) -> np.ndarray | None:
    """Finds the pixels that are fixed in these views; None if there are none."""
    views = [scene.views[index] for index in indices]
    if len(views) < FEWEST_COMPARED or any(
        view.mask_path is not None or view.valid is not None for view in views
    ):
        return None
    camera = scene.camera(indices[0])
    factor = min(1.0, COMPARED_SIDE / max(camera.width, camera.height))
    small = scene.scale_images(factor, decodes_small=True)
    chosen = choose_evenly(indices)
    try:
        with concurrent.futures.ThreadPoolExecutor(_core.num_threads(), "gsut-fixed") as threads:
            pictures = list(threads.map(small.image, chosen))
    except DatasetError:
        return None  # a damaged photograph is reported when it is used
    if any(small.alpha(index) is not None for index in chosen):
        return None
    axes = np.stack([view.camera_from_world[2, :3] for view in views])
    far_moves = float((axes @ axes.T).min()) < math.cos(_LEAST_TURN)
    fixed = find_fixed_pixels(np.stack(pictures), far_moves)
    return fixed if fixed.any() else None


def describe_fixed(scene: Scene) -> list[str]:
    """Returns a sentence on each different set of fixed pixels that training leaves out."""
    shares = {id(each): float(each.mean()) for each in scene.fixed if each is not None}
    return [
        f"{describe_fixed_pixels(share)}: they are left out; --keep-all-pixels keeps them"
        for share in shares.values()
    ]
