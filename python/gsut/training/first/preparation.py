"""Prepares a scene for training: size of its images, sharp photographs, background, poses."""

from __future__ import annotations

import re

import numpy as np

from gsut.data import Scene, list_some
from gsut.data.scene import with_shutter
from gsut.gaussians import Gaussians
from gsut.refine import TracksResult, check_refinable, refine_by_tracks
from gsut.run import Progress, TrainOptions

# Photographs whose edges decide on a plain background, spread evenly: reading all takes longer.
_EDGE_PHOTOGRAPHS = 8
# Grey levels by which pixels of one colour may differ: rounding and light compression.
_SAME_COLOR = 2
# A photograph is blurred if its edges have less than this share of its neighbours' contrast.
_BLURRED_SHARE = 0.7
# Photographs on either side that a photograph is compared with: they show much the same.
_NEIGHBOURS = 3
# Percent of the pixels, those with the steepest slopes, that count as edges.
_EDGE_PERCENT = 25
# Pixels, standard deviation of the smoothing that keeps noise from passing for edges.
_SMOOTHING = 0.8


def prepare_scene(scene: Scene, options: TrainOptions) -> Scene:
    """Rescales the scene and sets its shutter according to `options`."""
    o = options
    small = scene if o.scale == 1.0 else scene.scale_images(o.scale)
    note = describe_resizing(scene, o)
    if note is not None:
        most = max(max(c.width, c.height) for c in scene.cameras)
        small = scene.scale_images(o.max_side / most, decodes_small=True)
        small = small.replace(notes=(*small.notes, note))
    return with_shutter(small, o.shutter, o.readout_time, o.readout_direction)


def describe_resizing(scene: Scene, options: TrainOptions) -> str | None:
    """Explains in a sentence that `max_side` shrinks the photographs; None if they fit."""
    sizes = [(c.width, c.height) for c in scene.cameras]
    width, height = max(sizes, key=max, default=(0, 0))
    if options.scale != 1.0 or not 0 < options.max_side < max(width, height):
        return None
    factor = options.max_side / max(width, height)
    return (
        f"the photographs of {width} x {height} are used at {round(factor * width)} x "
        f"{round(factor * height)} (--max-side {options.max_side}; 0: as large as they are)"
    )


def leave_out_blurred(scene: Scene, options: TrainOptions) -> Scene:
    """Removes blurred photographs from the training views if `drop_blurred` is set."""
    if not options.drop_blurred:
        return scene
    order = sorted(scene.train_indices, key=lambda index: _order_in_time(scene.views[index].name))
    sharp = np.array([_measure_edge_contrast(scene, index) for index in order])
    blurred = set()
    for place, index in enumerate(order):
        around = sharp[max(0, place - _NEIGHBOURS) : place + _NEIGHBOURS + 1]
        if sharp[place] < _BLURRED_SHARE * np.median(around):
            blurred.add(index)
    names = [scene.views[index].name for index in sorted(blurred)]
    note = f"{len(names)} blurred photographs are left out: {list_some(names)}"
    kept = [index for index in scene.train_indices if index not in blurred]
    return scene.replace(train_indices=kept, notes=(*scene.notes, note)) if names else scene


def _order_in_time(name: str) -> tuple[str, int, str]:
    """Returns a sort key: the camera's folder, then the number that ends the name, if any."""
    folder, _, last = name.rpartition("/")
    digits = re.search(r"(\d+)\D*$", last)
    return folder, int(digits[1]) if digits else 0, last


def _measure_edge_contrast(scene: Scene, index: int) -> float:
    """Returns the slope of a photograph's edges in grey levels per pixel."""
    import cv2

    grey = cv2.cvtColor(scene.image(index), cv2.COLOR_RGB2GRAY).astype(np.float32)
    smooth = cv2.GaussianBlur(grey, (0, 0), _SMOOTHING)
    slopes = np.hypot(cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1))
    shown = slopes[scene.mask(index)]
    return float(np.percentile(shown, 100 - _EDGE_PERCENT)) if len(shown) else 0.0


def find_plain_background(scene: Scene) -> tuple[float, float, float] | None:
    """Finds the colour that most of the photographs' border pixels share.

    Returns:
        The colour; black if most of the border is masked, as around an object that was cut out;
        None if no more than half of the border pixels agree.
    """
    colors, edges, cut_out = [], 0, 0
    for index in scene.train_indices[:: -(-len(scene.train_indices) // _EDGE_PHOTOGRAPHS)]:
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
    alike = np.abs(shown - middle).max(axis=1) <= _SAME_COLOR
    if 2 * np.count_nonzero(alike) <= edges:
        return None
    red, green, blue = (middle / 255.0).tolist()
    return red, green, blue


def center_on_cameras(scene: Scene, gaussians: Gaussians) -> tuple[Scene, Gaussians]:
    """Moves a scene and Gaussians of its world to coordinates centred on the cameras."""
    near = scene.centred
    shift = near.world_offset - scene.world_offset
    return near, gaussians.translate(-shift).with_origin((0.0, 0.0, 0.0))


def refine_first_poses(scene: Scene, options: TrainOptions, progress: bool) -> TracksResult | None:
    """Refines the training views' poses by tracks of features, if `options` request it.

    Args:
        scene: as it is trained on.
        options: of the run.
        progress: whether to show a bar.

    Returns:
        The refined poses and how they were found; None if not requested.
    """
    if not (options.refine_poses and options.refine_tracks):
        return None
    check_refinable(scene, options)
    with Progress(progress) as bar:
        return refine_by_tracks(scene, options, bar.show)
