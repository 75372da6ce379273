"""Chooses the first Gaussians: on points, a sky, where photographs agree, or at random."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.data import Scene
from gsut.data.points import color_points, has_colors
from gsut.data.scene import has_depths, read_depth
from gsut.gaussians import (
    Gaussians,
    choose_points,
    seed_from_points,
    seed_in_view,
)
from gsut.run import TrainOptions
from gsut.sampling import choose_evenly
from gsut.surface import Cloud, DepthMap
from gsut.surface.stereo import find_points_by_stereo, measure_coverage
from gsut.training.first.sky import describe_sky, find_sky

# Nearest distance of random first Gaussians from a camera, x scene extent: nearer fills the view.
_RANDOM_NEAR = 0.05
# Farthest distance of random first Gaussians from a camera, x scene extent: far walls and hills.
_RANDOM_FAR = 4.0
# Most first Gaussians at random or at known depths, which cost no search; growth adds more where
# they are needed.
_MOST_FREE = 30_000
# Most points found by stereo: growth places the others where detail is.
_STEREO_COUNT = 8000
# Most views whose depths are read for them.
_MOST_DEPTHS = 100
# Points found by stereo that each of the dataset's, which are more exact, replaces.
_STEREO_PER_POINT = 2
# Largest share of the most Gaussians that stereo may take: the others grow where needed.
_STEREO_SHARE = 0.4
# The same of known depths, which are more exact.
_DEPTH_SHARE = 0.8
# Share of the training views that the dataset's points must cover to need no others.
_COVERED = 0.8

Colored = tuple[np.ndarray, np.ndarray]  # points (N, 3) and their colours (N, 3) uint8


def choose_first_gaussians(scene: Scene, options: TrainOptions) -> tuple[Gaussians, list[str]]:
    """Chooses what training starts from.

    It starts from the dataset's points, from a sky if the photographs show one, and from known
    depths, or what stereo finds in the photographs, if the points cover too little of them.

    Args:
        scene: as it is trained on.
        options: of the run.

    Returns:
        The Gaussians, and notes on those that come from photographs alone.
    """
    sky = _find_sky_to_seed(scene, options)
    found = _find_points_to_seed(scene, options, 0 if sky is None else len(sky[0]))
    notes = [] if sky is None else [describe_sky(len(sky[0]))]
    if found is not None:
        where = "at known depths" if has_depths(scene) else "where photographs agree"
        notes.append(
            f"{len(found[0])} of the first Gaussians lie {where}, beside {len(scene.points)} "
            "points of the data."
        )
    return seed_first(scene, options, [more for more in (sky, found) if more is not None]), notes


def _find_points_to_seed(scene: Scene, options: TrainOptions, sky: int) -> Colored | None:
    """Finds points by depth files or stereo if the options leave the first Gaussians open and the
    dataset's points cover too little."""
    o, given = options, len(scene.points)
    if o.init != "auto":
        return None
    by_files = has_depths(scene)  # depth files add to the points, and not stereo
    most, share = (_MOST_FREE, _DEPTH_SHARE) if by_files else (_STEREO_COUNT, _STEREO_SHARE)
    most = min(most, round(share * o.max_gaussians))
    count = min(most - _STEREO_PER_POINT * given, o.max_gaussians - given - sky)
    if count <= 0 or measure_coverage(scene) >= _COVERED:
        return None
    if by_files:
        return _find_points_by_depth(scene, count, o.seed)
    return find_points_by_stereo(scene, count, o.seed)


def _find_points_by_depth(scene: Scene, most: int, seed: int) -> Colored | None:
    """Finds points and colours at the depths of training views, one in each voxel."""
    import cv2

    cloud = Cloud()
    for view in choose_evenly(scene.train_indices, _MOST_DEPTHS):
        depth = read_depth(scene, view)
        if depth is None:
            continue
        depth = np.where(depth > 0, depth, np.nan).astype(np.float32)
        size = depth.shape[::-1]
        mask = cv2.resize(scene.mask(view).astype(np.uint8), size) > 0
        depth[~mask] = np.nan
        image = cv2.resize(scene.image(view), size, interpolation=cv2.INTER_AREA)
        camera = scene.camera(view).resize(*size)
        cloud.add(DepthMap(camera, scene.views[view].motion, depth, image=image))
    if not len(cloud):
        return None
    mesh = cloud.to_mesh()
    rows = choose_points(len(cloud), most, seed)
    colors = np.round(255 * np.asarray(mesh.colors)[rows]).astype(np.uint8)
    return mesh.vertices[rows], colors


def _find_sky_to_seed(scene: Scene, options: TrainOptions) -> Colored | None:
    """Finds a sky if the options leave the first Gaussians open and there is room for it."""
    o = options
    if o.init != "auto" or not len(scene.points) or o.background is not None:
        return None
    sky = find_sky(scene)
    if sky is None or min(len(scene.points), o.max_gaussians) + len(sky[0]) > o.max_gaussians:
        return None
    return sky


def _is_on_points(scene: Scene, options: TrainOptions) -> bool:
    return options.init != "random" and len(scene.points) > 0


def seed_first(scene: Scene, options: TrainOptions, more: Sequence[Colored] = ()) -> Gaussians:
    """Seeds Gaussians on the scene's points and `more`, or at random within the cameras' view.

    Args:
        scene: as it is trained on.
        options: of the run.
        more: points and colours beside the scene's, see `find_sky` and `find_points_by_stereo`.

    Raises:
        InputError: `init` is "points" and the scene has none.
    """
    o = options
    shape: dict[str, Any] = {"sh_degree": o.sh_degree, "seed": o.seed}
    if o.init == "points" and len(scene.points) == 0:
        raise InputError(f"{scene.path} has no points to start from; use init='random'")
    if more or _is_on_points(scene, o):
        first = seed_from_points(*_choose_colored_points(scene, o, more), **shape)
    else:
        first = seed_in_view(
            [scene.camera(i) for i in scene.train_indices], scene.poses(scene.train_indices),
            min(_MOST_FREE, o.max_gaussians), near=_RANDOM_NEAR * scene.extent,
            far=_RANDOM_FAR * scene.extent, **shape,
        )  # fmt: skip
    first = dataclasses.replace(first, response=o.response, order=o.order)
    if o.primitive in Gaussians.PRIMITIVES:
        return first.to_primitive(o.primitive)
    return first.to_surfels() if o.primitive == "surfel" else first


def _choose_colored_points(scene: Scene, options: TrainOptions, more: Sequence[Colored]) -> Colored:
    """Joins the scene's points, drawn if they exceed the most Gaussians, with `more`."""
    most = min(len(scene.points), options.max_gaussians)
    rows = choose_points(len(scene.points), most, options.seed)
    points, colors = scene.points[rows], scene.point_colors[rows]
    if len(points) and not has_colors(scene):
        colors, _ = color_points(scene, points)
    points = np.concatenate([points, *(each for each, _ in more)])
    return points, np.concatenate([colors, *(each for _, each in more)])
