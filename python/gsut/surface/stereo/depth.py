"""Depth maps of photographs from poses and lenses alone, without training."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gsut._core import InputError
from gsut.bounds import name_wrong_kinds
from gsut.data import Scene
from gsut.surface.depth_map import DepthMap
from gsut.surface.stereo.normals import fit_normals
from gsut.surface.stereo.sweep import OnView, Shown, find_distances, ignore_view


@name_wrong_kinds
def find_depth_maps(
    scene: Scene,
    views: Sequence[int] | None = None,
    *,
    agree: int = 1,
    on_view: OnView = ignore_view,
) -> list[DepthMap]:
    """Finds the depth that photographs show, by comparing them through their lenses and shutters.

    Photographs are compared at 200 pixels; the maps have the size of the scene's images, and the
    sharpness of the smaller ones.

    Args:
        scene: with known poses and lenses.
        views: indices of the views that get a map; None: all, training and held-out ones.
        agree: other views that must show the same surface at a pixel; 0: all pixels that see
            anything get a depth.
        on_view: called with the number of sweeps done and of all.

    Returns:
        One map for each view: distances along the rays, NaN where unknown; as weight the share of
        two other views that agree, from 0 to 1; the photograph as image; and normals.

    Raises:
        InputError: fewer than two views, an index that is none, or photographs of which hardly
            anything is alike.
    """
    chosen = list(range(len(scene.views))) if views is None else list(views)
    if len(scene.views) < 2:
        raise InputError(f"{scene.path} has one view; stereo compares at least two")
    unknown = [view for view in chosen if not 0 <= view < len(scene.views)]
    if unknown:
        raise InputError(f"views: {unknown[0]} is none of 0 ... {len(scene.views) - 1}")
    if agree < 0:
        raise InputError(f"agree is {agree}; give the number of other views, at least 0")
    every = scene.replace(train_indices=list(range(len(scene.views))), test_indices=[])
    shown = find_distances(every.centred, chosen, on_view)
    if not shown:
        raise InputError(
            f"{scene.path}: hardly anything in neighbouring photographs is alike by these poses "
            "and lenses; `gsut doctor` shows what contradicts what"
        )
    return [_make_map(scene, view, shown[view], agree) for view in chosen]


def _make_map(scene: Scene, view: int, shown: Shown, agree: int) -> DepthMap:
    """Resizes what a view shows to the size of its image."""
    import cv2

    camera = scene.camera(view)
    size = (camera.width, camera.height)
    inverse = np.where(shown.agree >= agree, shown.inverse, 0)
    normals = fit_normals(shown.photograph, inverse)
    inverse = cv2.resize(inverse, size, interpolation=cv2.INTER_NEAREST)
    trust = cv2.resize(shown.trust, size, interpolation=cv2.INTER_NEAREST)
    known = (inverse > 0) & scene.mask(view)
    depth = np.full(inverse.shape, np.nan, np.float32)
    depth[known] = 1 / inverse[known]
    weight = np.where(known, trust, np.float32(0))
    normals = cv2.resize(normals, size, interpolation=cv2.INTER_NEAREST)
    normals[~known] = 0
    return DepthMap(camera, scene.views[view].motion, depth, weight, scene.image(view), normals)
