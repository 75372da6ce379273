"""What training starts from: the scene as it was asked for, first poses, first Gaussians."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.data import Scene, list_some
from gsut.data.points import color_points, has_colors
from gsut.data.scene import with_shutter
from gsut.gaussians import (
    Gaussians,
    choose_points,
    seed_from_points,
    seed_in_view,
    to_surfels,
)
from gsut.refine import TracksResult, check_refinable, refine_by_tracks
from gsut.run import Progress, TrainOptions
from gsut.training.first_sky import first_sky, sky_note
from gsut.training.plane_sweep import swept_points

# Random first Gaussians lie between these distances from a camera, in units of the scene's extent.
_RANDOM_NEAR, _RANDOM_FAR = 0.05, 4.0
_RANDOM_COUNT = 30_000
# Where points are few a plane sweep finds others: so many, less eight times the data's, and no more
# than this share of the most Gaussians, which then grow where they are needed. Beside 3000 and more
# it gains up to 0.5 dB, but distances are worse (median 4.7 % instead of 2.2 on a small hall).
_SWEPT_COUNT, _EACH_POINT, _SWEPT_SHARE = 20_000, 8, 0.4
# A background of its own: photographs that are looked at, and grey levels that are one colour.
_LOOKED_AT, _ALIKE = 8, 2
# Blurred is a photograph whose edges have less of this share of the contrast that those of its
# neighbours have, so many on either side; edges are this part of the pixels with most of it.
_BLURRED, _NEIGHBOURS, _EDGES = 0.7, 3, 25
_FINEST = 0.8  # pixels, standard deviation of the smoothing against noise


def prepare_scene(scene: Scene, options: TrainOptions) -> Scene:
    """The scene at the size, and with the shutter, that the options ask for, where it stands."""
    o = options
    small = scene if o.scale == 1.0 else scene.scaled(o.scale)
    note = size_note(scene, o)
    if note is not None:
        most = max(max(c.width, c.height) for c in scene.cameras)
        small = scene.scaled(o.max_side / most, decodes_small=True)
        small = small.replace(notes=(*small.notes, note))
    return with_shutter(small, o.shutter, o.readout_time, o.readout_direction)


def without_blurred(scene: Scene, options: TrainOptions) -> Scene:
    """The scene without the training photographs that are blurred, where the options ask for it."""
    if not options.drop_blurred:
        return scene
    order = sorted(scene.train_indices, key=lambda index: _place_in_time(scene.views[index].name))
    sharp = np.array([_edge_contrast(scene, index) for index in order])
    blurred = set()
    for place, index in enumerate(order):
        around = sharp[max(0, place - _NEIGHBOURS) : place + _NEIGHBOURS + 1]
        if sharp[place] < _BLURRED * np.median(around):
            blurred.add(index)
    names = [scene.views[index].name for index in sorted(blurred)]
    note = f"{len(names)} blurred photographs are left out: {list_some(names)}"
    kept = [index for index in scene.train_indices if index not in blurred]
    return scene.replace(train_indices=kept, notes=(*scene.notes, note)) if names else scene


def _place_in_time(name: str) -> tuple[str, int, str]:
    """By camera, then by the number that ends the name, if there is one."""
    folder, _, last = name.rpartition("/")
    digits = re.search(r"(\d+)\D*$", last)
    return folder, int(digits[1]) if digits else 0, last


def _edge_contrast(scene: Scene, index: int) -> float:
    """The slope that the edges of a photograph have, in grey levels a pixel."""
    import cv2

    grey = cv2.cvtColor(scene.image(index), cv2.COLOR_RGB2GRAY).astype(np.float32)
    smooth = cv2.GaussianBlur(grey, (0, 0), _FINEST)
    slopes = np.hypot(cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1))
    shown = slopes[scene.mask(index)]
    return float(np.percentile(shown, 100 - _EDGES)) if len(shown) else 0.0


def size_note(scene: Scene, options: TrainOptions) -> str | None:
    """That the photographs are made smaller, and how to have them as they are; None: they fit."""
    sizes = [(c.width, c.height) for c in scene.cameras]
    width, height = max(sizes, key=max, default=(0, 0))
    if options.scale != 1.0 or not 0 < options.max_side < max(width, height):
        return None
    factor = options.max_side / max(width, height)
    return (
        f"the photographs of {width} x {height} are used at {round(factor * width)} x "
        f"{round(factor * height)} (--max-side {options.max_side}; 0: as large as they are)"
    )


def plain_background(scene: Scene) -> tuple[float, float, float] | None:
    """The colour that most of the photographs' edges have, as behind an object on its own.

    Returns:
        The colour; black where most of the edges are masked, as around an object that is cut out;
        None where no more than half of the edges' pixels agree.
    """
    colors, edges, cut_out = [], 0, 0
    for index in scene.train_indices[:: -(-len(scene.train_indices) // _LOOKED_AT)]:
        mask = scene.mask(index)
        edge = np.ones(mask.shape, bool)
        edge[1:-1, 1:-1] = False
        edges += int(np.count_nonzero(edge))
        cut_out += int(np.count_nonzero(edge & ~mask & scene.camera(index).rays()[1]))
        colors.append(scene.image(index)[edge & mask].astype(np.int16))
    if 2 * cut_out > edges:
        return (0.0, 0.0, 0.0)
    shown = np.concatenate(colors)
    if 2 * len(shown) <= edges:
        return None
    middle = np.median(shown, axis=0)
    alike = np.abs(shown - middle).max(axis=1) <= _ALIKE
    if 2 * np.count_nonzero(alike) <= edges:
        return None
    red, green, blue = (middle / 255.0).tolist()
    return red, green, blue


def about_cameras(scene: Scene, gaussians: Gaussians) -> tuple[Scene, Gaussians]:
    """`Scene.centred`, and Gaussians of the scene's world in the same coordinates."""
    near = scene.centred
    shift = near.world_offset - scene.world_offset
    return near, gaussians.translate(-shift).with_origin((0.0, 0.0, 0.0))


def refine_first_poses(scene: Scene, options: TrainOptions, progress: bool) -> TracksResult | None:
    """The training views' poses refined by tracks of features, with a bar if `progress`.

    None where the options do not ask for it.
    """
    if not (options.refine_poses and options.refine_tracks):
        return None
    check_refinable(scene, options)
    with Progress(progress) as bar:
        return refine_by_tracks(scene, options, bar.show)


def first_gaussians(scene: Scene, options: TrainOptions) -> tuple[Gaussians, list[str]]:
    """What training starts from, and notes of what of it the photographs alone have given.

    On the data's points; a sky, where photographs show one; and where points are few or none, on
    what a plane sweep finds in the photographs.

    Args:
        scene: as it is trained on.
        options: resolved.
    """
    sky = _sky_to_seed(scene, options)
    swept = _swept_to_seed(scene, options, 0 if sky is None else len(sky[0]))
    notes = [] if sky is None else [sky_note(len(sky[0]))]
    if swept is not None:
        notes.append(
            f"{len(swept[0])} of the first Gaussians lie where neighbouring photographs agree, "
            f"beside {len(scene.points)} points of the data (--init points or random: without)."
        )
    return seed_first(scene, options, [more for more in (sky, swept) if more is not None]), notes


def _swept_to_seed(
    scene: Scene, options: TrainOptions, sky: int
) -> tuple[np.ndarray, np.ndarray] | None:
    """`swept_points`, where the options leave the first Gaussians open and points are few."""
    o = options
    given = _SWEPT_COUNT if o.init_count is None else o.init_count
    most = min(given, round(_SWEPT_SHARE * o.max_gaussians))
    count = most - _EACH_POINT * len(scene.points)
    if o.init != "auto" or (o.init_count is not None and len(scene.points)) or count <= 0:
        return None
    return swept_points(scene, min(count, o.max_gaussians - len(scene.points) - sky), o.seed)


def _sky_to_seed(scene: Scene, options: TrainOptions) -> tuple[np.ndarray, np.ndarray] | None:
    """`first_sky`, where the options leave the first Gaussians open and there is room for it."""
    o = options
    if not _on_points(scene, o) or o.init_count is not None or o.background is not None:
        return None
    sky = first_sky(scene)
    if sky is None or min(len(scene.points), o.max_gaussians) + len(sky[0]) > o.max_gaussians:
        return None
    return sky


def _on_points(scene: Scene, options: TrainOptions) -> bool:
    return options.init != "random" and len(scene.points) > 0


def seed_first(
    scene: Scene, options: TrainOptions, more: Sequence[tuple[np.ndarray, np.ndarray]] = ()
) -> Gaussians:
    """The Gaussians that training starts from: on the scene's points and `more`, or random in view.

    Args:
        scene: as it is trained on.
        options: resolved.
        more: points and colours, see `first_sky` and `swept_points`.
    """
    first = _seed_gaussians(scene, options, more)
    return to_surfels(first) if options.primitive == "surfel" else first


def _seed_gaussians(
    scene: Scene, options: TrainOptions, more: Sequence[tuple[np.ndarray, np.ndarray]]
) -> Gaussians:
    o = options
    shape: dict[str, Any] = {
        "sh_degree": o.sh_degree,
        "scale_factor": o.init_scale,
        "opacity": o.init_opacity,
        "seed": o.seed,
    }
    if o.init == "points" and len(scene.points) == 0:
        raise InputError(f"{scene.path} has no points to start from; use --init random")
    if not more and not _on_points(scene, o):
        return seed_in_view(
            [scene.camera(i) for i in scene.train_indices], scene.poses(scene.train_indices),
            min(o.init_count or _RANDOM_COUNT, o.max_gaussians), near=_RANDOM_NEAR * scene.extent,
            far=_RANDOM_FAR * scene.extent, **shape,
        )  # fmt: skip
    most = min(o.init_count or len(scene.points), o.max_gaussians)
    rows = choose_points(len(scene.points), most, o.seed)
    points, colors = scene.points[rows], scene.point_colors[rows]
    if len(points) and not has_colors(scene):
        colors, _ = color_points(scene, points)
    points = np.concatenate([points, *(each for each, _ in more)])
    colors = np.concatenate([colors, *(each for _, each in more)])
    return seed_from_points(points, colors, **shape)
