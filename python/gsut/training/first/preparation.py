"""Prepares a scene for training: size of its images, background, poses."""

from __future__ import annotations

import numpy as np

from gsut.data import Scene
from gsut.data.scene import with_shutter
from gsut.gaussians import Gaussians
from gsut.refine import TracksResult, check_refinable, refine_by_tracks
from gsut.run import Progress, TrainOptions
from gsut.run.options import READOUTS
from gsut.training.first.fixed_pixels import find_fixed_of_cameras

# Photographs whose edges decide on a plain background, spread evenly: reading all takes longer.
_EDGE_PHOTOGRAPHS = 8
# Grey levels by which pixels of one colour may differ: rounding and light compression.
_SAME_COLOR = 2


def prepare_scene(scene: Scene, options: TrainOptions) -> Scene:
    """Rescales the scene and sets its shutter according to `options`."""
    o = options
    small = scene if o.scale == 1.0 else scene.scale_images(o.scale)
    note = describe_resizing(scene, o)
    if note is not None:
        most = max(max(c.width, c.height) for c in scene.cameras)
        small = scene.scale_images(o.max_side / most, decodes_small=True)
        small = small.replace(notes=(*small.notes, note))
    fixed = () if o.keep_all_pixels else find_fixed_of_cameras(small)
    if fixed:
        small = small.replace(fixed=fixed)
    if o.shutter in READOUTS:
        return with_shutter(small, "rolling", o.readout_time, o.shutter)
    return with_shutter(small, o.shutter, o.readout_time, "top_to_bottom")


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
        seen = scene.find_lens_mask(scene.views[index].camera_index)
        cut_out += int(np.count_nonzero(edge & ~mask & seen))
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
    if not options.refine_poses:
        return None
    check_refinable(scene, options)
    with Progress(progress) as bar:
        return refine_by_tracks(scene, options, bar.show)
