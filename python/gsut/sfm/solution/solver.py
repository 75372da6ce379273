"""Calls the solver that turns matches into poses and points, or adjusts poses that are known."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from gsut import _core
from gsut._core import SolveError
from gsut.sfm.matches import (
    MIN_ANGLE_DEGREES,
    ROLLING_ERROR,
    PairMatches,
    select_verified_pairs,
)
from gsut.sfm.photographs import Features, Images, PosesOptions, order_by_folder
from gsut.sfm.solution.adjustment import (
    LOSS_SCALE,
    PLAIN,
    Adjustment,
    IndexedLenses,
    index_lenses,
    state_lenses,
)
from gsut.sfm.solution.result import (
    FEATURE_VARIANCE,
    Solution,
    average_colors,
    evaluate_observations,
    measure_diagonal,
)

# Rounds of track extension at the end, in which points are sought in images that do not observe
# them yet: more add few observations.
_EXTEND_ROUNDS = 2
# Search radius around the predicted pixel of a point, in thousandths of the image's diagonal.
_EXTEND_RADIUS = 2.2
# Largest distance of a feature's descriptor, of unit length, to the mean descriptor of the point.
_EXTEND_DISTANCE = 0.8
# Called with (registered images, images, points, name of the step) after each step.
OnStep = Callable[..., None]


def ignore_step(*_: Any) -> None:
    """Does nothing: for trials that show no progress."""


def solve_poses(
    images: Images,
    pairs: Sequence[PairMatches],
    options: PosesOptions,
    on_step: OnStep = ignore_step,
    adjustment: Adjustment = PLAIN,
) -> Solution:
    """Estimates poses and points from verified matches alone.

    Raises:
        SolveError: nothing could be reconstructed; says why.
    """
    settings = _make_settings(images, options, adjustment)
    if images.shutter is not None:
        settings["shutter"] = images.shutter.direction
        settings["rolling_error"] = ROLLING_ERROR
        if images.lines is not None:
            settings |= images.lines.to_settings()
        if options.readout_time is not None:
            settings["readout_time"] = options.readout_time
            times, folders = order_by_folder(images.names)
            settings |= {"frame_times": times.tolist(), "frame_cameras": folders.tolist()}
    if adjustment.covariances:
        settings |= _list_extension_settings(images)
    lenses = index_lenses(images.cameras, adjustment.lens_free)
    found = _core.estimate_poses(
        lenses.cameras, lenses.of_image, [f.pixels for f in images.features],
        [p.as_tuple() for p in pairs], settings, on_step,
    )  # fmt: skip
    solution = _make_solution(images, found, lenses)
    if images.shutter is None:
        return solution
    return dataclasses.replace(
        solution, shutter=images.shutter, lines=images.lines, velocities=found["velocities"]
    )


def adjust_poses(
    images: Images,
    pairs: Sequence[PairMatches],
    camera_from_world: Sequence[np.ndarray],
    options: PosesOptions,
    on_step: OnStep = ignore_step,
    adjustment: Adjustment = PLAIN,
) -> Solution:
    """Adjusts poses that are roughly right, their points, and the lens if it is free.

    Args:
        camera_from_world: (4, 4) poses, one an image; their world is kept.

    Raises:
        SolveError: too few points agree with the poses.
    """
    rig, motion = adjustment.rig, adjustment.motion
    settings = _make_settings(images, options, adjustment)
    if motion is not None:
        settings.update(motion.to_settings())
        if images.lines is not None:
            settings |= images.lines.to_settings()
    for stated in (adjustment.places, adjustment.points, adjustment.turns):
        settings |= {} if stated is None else stated.to_settings()
    if rig is not None or adjustment.extend:
        settings |= _list_extension_settings(images)
    lenses = index_lenses(images.cameras, adjustment.lens_free)
    found = _core.refine_structure(
        lenses.cameras, lenses.of_image, [f.pixels for f in images.features],
        [p.as_tuple() for p in pairs], list(camera_from_world), settings,
        on_step,
        [] if rig is None else rig.registered.astype(int).tolist(),
        None if rig is None else rig.to_settings(),
    )  # fmt: skip
    solution = _make_solution(images, found, lenses)
    if rig is not None:
        mounts = np.array(found["camera_from_body"])
        solution = dataclasses.replace(solution, camera_from_body=mounts)
    if motion is None:
        return solution
    return dataclasses.replace(
        solution, shutter=motion.shutter, lines=images.lines, velocities=found["velocities"]
    )


def adjust_registered(
    solution: Solution,
    features: Sequence[Features],
    pairs: Sequence[PairMatches],
    options: PosesOptions,
    on_step: OnStep = ignore_step,
    adjustment: Adjustment = PLAIN,
) -> Solution:
    """Adjusts the images that have a pose; the others stay without.

    Args:
        solution: the poses to start from.
        features, pairs: of all images.
        adjustment: `motion` has one rate for each of all images.

    Raises:
        SolveError: fewer than two images have a pose, or too few points agree with the poses.
    """
    chosen = np.flatnonzero(solution.registered)
    if len(chosen) < 2:
        raise SolveError("fewer than two images have a pose to adjust")
    images = Images(solution.names, solution.cameras, features, lines=solution.lines)
    images = images.select(chosen)
    poses = [solution.camera_from_world[i] for i in chosen]
    own = select_verified_pairs(pairs, chosen)
    adjusted = adjust_poses(images, own, poses, options, on_step, adjustment.select(chosen))
    return _spread_solution(adjusted, chosen, solution)


def _list_extension_settings(images: Images) -> dict[str, Any]:
    """Returns the solver's settings for the extension of tracks."""
    return {
        "descriptors": [f.descriptors for f in images.features],
        "extend_rounds": _EXTEND_ROUNDS,
        "extend_radius": _EXTEND_RADIUS * measure_diagonal(images.cameras) / 1000,
        "extend_distance": _EXTEND_DISTANCE,
    }


def _make_settings(images: Images, options: PosesOptions, adjustment: Adjustment) -> dict[str, Any]:
    """Returns the settings that both ways of solving share."""
    settings: dict[str, Any] = {
        "max_error": options.max_error * measure_diagonal(images.cameras) / 1000,
        "min_angle": math.radians(MIN_ANGLE_DEGREES),
        "min_inliers": adjustment.min_inliers,
        "loss_scale": LOSS_SCALE,
        "seed": options.seed,
        "lens_settled": adjustment.lens_settled,
        "covariances": adjustment.covariances,
    }
    if any(f.is_learned is not None for f in images.features):
        settings["is_other"] = [f.flag_learned().tolist() for f in images.features]
    if adjustment.lens_free is not None:
        lenses = index_lenses(images.cameras, adjustment.lens_free)
        free = [[] if f is None else [int(flag) for flag in f] for f in lenses.free]
        settings |= {"lens_free": free, **state_lenses(lenses, adjustment.center_sigma)}
    return settings


def _make_solution(images: Images, found: dict[str, Any], lenses: IndexedLenses) -> Solution:
    """Builds a solution from the solver's answer."""
    if found["failure"]:
        raise SolveError(found["failure"])
    if not np.any(found["registered"]):
        raise SolveError("no image keeps its points once poses are adjusted")
    solved = [
        camera if free is None else camera.with_params(params)
        for camera, free, params in zip(
            lenses.cameras, lenses.free, found["lens_params"], strict=True
        )
    ]
    own = [solved[lens] for lens in lenses.of_image]
    observations = found["observations"]
    pixels, residuals, angles = evaluate_observations(
        observations, found["observations_in_camera"], own, images.features
    )
    of_images = [f.colors for f in images.features]
    colors = average_colors(observations, len(found["points"]), of_images)
    return Solution(
        list(images.names), own, found["registered"], found["camera_from_world"],
        FEATURE_VARIANCE * found["covariances"],
        found["points"], colors, found["point_errors"], observations, pixels, residuals, angles,
        found["initial_pair"], found["restarts"], found["rms"], found["median"],
        learned_noise=found["other_noise"],
    )  # fmt: skip


def _spread_solution(model: Solution, chosen: np.ndarray, whole: Solution) -> Solution:
    """Turns a solution of some images into one of all images of `whole`."""
    count = len(whole.names)

    def spread(values: np.ndarray, empty: np.ndarray) -> np.ndarray:
        result = np.repeat(empty[None], count, axis=0)
        result[chosen] = values
        return result

    observations = model.observations.copy()
    observations[:, 1] = chosen[observations[:, 1]]
    lenses = {whole.cameras[i]: lens for i, lens in zip(chosen, model.cameras, strict=True)}
    first, second = (int(chosen[i]) for i in model.initial_pair)
    moving = model.velocities
    return dataclasses.replace(
        model,
        names=whole.names,
        cameras=[lenses.get(camera, camera) for camera in whole.cameras],
        registered=spread(model.registered, np.zeros((), bool)),
        camera_from_world=spread(model.camera_from_world, np.eye(4)),
        covariances=spread(model.covariances, np.zeros((6, 6))),
        velocities=None if moving is None else spread(moving, np.zeros(6)),
        lines=None if moving is None else whole.lines,
        observations=observations,
        initial_pair=(first, second),
    )
