"""Calls the solver that turns matches into poses and points, or adjusts poses that are known."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from gsut import _core
from gsut._core import Shutter, SolveError
from gsut.data.scene import order_frames
from gsut.lens import Camera
from gsut.sfm.matches import PairMatches, select_verified_pairs
from gsut.sfm.photographs import Features, Images, PosesOptions
from gsut.sfm.solution.result import (
    FEATURE_VARIANCE,
    Solution,
    average_colors,
    evaluate_observations,
    measure_diagonal,
)

# Called with (registered images, images, points, name of the step) after each step.
OnStep = Callable[[int, int, int, str], None]


@dataclasses.dataclass(frozen=True)
class RigConstraint:
    """What is known of a rig before its poses are adjusted.

    Args:
        body_of_image: (N,) the rig's place that an image was taken from, from 0 without gaps.
        mount_of_image: (N,) the mount of its camera on the body; -1: the camera is the body.
        camera_from_body: (M, 4, 4) of the mounts.
        registered: (N,) bool, whether an image's pose is known; all of a body, or none.
        adjust: adjust the mounts too; the rig keeps its size.
    """

    body_of_image: np.ndarray
    mount_of_image: np.ndarray
    camera_from_body: np.ndarray
    registered: np.ndarray
    adjust: bool = False

    def to_settings(self) -> dict[str, Any]:
        """Returns the settings that the solver takes."""
        return {
            "body_of_image": self.body_of_image.tolist(),
            "mount_of_image": self.mount_of_image.tolist(),
            "camera_from_body": list(self.camera_from_body),
            "refine": self.adjust,
        }


@dataclasses.dataclass(frozen=True)
class ReadoutMotion:
    """How the camera moves while images are read line by line.

    Args:
        shutter: the order of the lines.
        readout: seconds from the first line to the last.
        rates: (N, 6) velocities per second (see Solution.velocities); NaN: not known.
        sigma: relative deviation of an image's own velocity from its rate.
        extend: extend tracks at the end.
    """

    shutter: Shutter
    readout: float
    rates: np.ndarray
    sigma: float = 0.1
    extend: bool = True

    def to_settings(self) -> dict[str, Any]:
        """Returns the settings that the solver takes."""
        return {
            "shutter": self.shutter.direction, "readout_time": self.readout,
            "image_rates": self.rates.tolist(), "rate_sigma": self.sigma,
        }  # fmt: skip


@dataclasses.dataclass(frozen=True)
class StatedPlaces:
    """Where cameras stood, as something other than images states it.

    Args:
        centers: (N, 3) in the world of the poses, one an image; NaN: not known.
        sigma: (3,) standard deviation of a coordinate.
    """

    centers: np.ndarray
    sigma: np.ndarray

    def to_settings(self) -> dict[str, Any]:
        """Returns the settings that the solver takes."""
        return {"places": self.centers.tolist(), "place_sigma": self.sigma.tolist()}


# See `Adjustment`.
LensFlags = np.ndarray | Sequence[np.ndarray | None] | None


@dataclasses.dataclass(frozen=True)
class Adjustment:
    """What is adjusted beside poses and points, and how.

    Args:
        lens_free: (K,) flags of the parameters of the one lens: 0 held, 1 estimated, equal flags
            above 1 tied; or such flags of each image's lens, one array a lens, None for one that is
            known; None: all lenses are known.
        lens_settled: the lens is nearly right, so that estimating it at the end is enough.
        hold_out_every: every n-th longer track keeps one observation out of all adjustments; 0:
            none.
        covariances: False for a trial: they are 0, and the solver ends at a rougher tolerance.
        rig: of `adjust_poses`: the images' cameras are fixed to each other.
        motion: of `adjust_poses`: images are read line by line.
        extend: of `adjust_poses`: look at the end for points in images that do not see them yet.
        places: of `adjust_poses`: where cameras stood, in the world of the poses, or None.
    """

    lens_free: LensFlags = None
    lens_settled: bool = False
    hold_out_every: int = 0
    covariances: bool = True
    rig: RigConstraint | None = None
    motion: ReadoutMotion | None = None
    extend: bool = False
    places: StatedPlaces | None = None


PLAIN = Adjustment()


@dataclasses.dataclass(frozen=True)
class IndexedLenses:
    """The different lenses of images.

    Args:
        cameras: each lens once, in order of its first image.
        free: flags of each lens, see `Adjustment`; None: known.
        of_image: number of each image's lens.
    """

    cameras: list[Camera]
    free: list[np.ndarray | None]
    of_image: list[int]


def index_lenses(cameras: Sequence[Camera], free: LensFlags) -> IndexedLenses:
    """Lists the different lenses of images; those with flags of their own differ even if equal."""
    flags = [free] * len(cameras) if free is None or isinstance(free, np.ndarray) else list(free)
    by_id = {id(each): each for each in flags}
    keys = [(camera, id(each)) for camera, each in zip(cameras, flags, strict=True)]
    place = {key: number for number, key in enumerate(dict.fromkeys(keys))}
    return IndexedLenses(
        [camera for camera, _ in place], [by_id[each] for _, each in place],
        [place[key] for key in keys],
    )  # fmt: skip


def ignore_step(done: int, total: int, points: int, step: str) -> None:
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
    settings |= {"lens_settled": adjustment.lens_settled, "covariances": adjustment.covariances}
    if images.shutter is not None:
        settings["shutter"] = images.shutter.direction
        settings["rolling_error"] = options.rolling_error
        if images.lines is not None:
            settings |= images.lines.to_settings()
        if options.readout_time is not None:
            settings["readout_time"] = options.readout_time
            times, folders = order_by_folder(images.names)
            settings |= {"frame_times": times.tolist(), "frame_cameras": folders.tolist()}
    if not adjustment.hold_out_every:
        descriptors = [f.descriptors for f in images.features]
        settings |= list_extension_settings(options, descriptors, images.cameras)
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
    settings["covariances"] = adjustment.covariances
    if motion is not None:
        settings.update(motion.to_settings())
        if images.lines is not None:
            settings |= images.lines.to_settings()
    if adjustment.places is not None:
        settings.update(adjustment.places.to_settings())
    is_extended = adjustment.extend or (motion is not None and motion.extend)
    if rig is not None or is_extended:
        descriptors = [f.descriptors for f in images.features]
        settings |= list_extension_settings(options, descriptors, images.cameras)
    lenses = index_lenses(images.cameras, adjustment.lens_free)
    found = _core.refine_structure(
        lenses.cameras, lenses.of_image, [f.pixels for f in images.features],
        [p.as_tuple() for p in pairs], list(camera_from_world), settings, on_step,
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
        SolveError: too few points agree with the poses.
    """
    chosen = np.flatnonzero(solution.registered)
    images = Images(solution.names, solution.cameras, features, lines=solution.lines)
    images = images.select(chosen)
    if adjustment.motion is not None:
        motion = dataclasses.replace(adjustment.motion, rates=adjustment.motion.rates[chosen])
        adjustment = dataclasses.replace(adjustment, motion=motion)
    if adjustment.places is not None:
        places = dataclasses.replace(adjustment.places, centers=adjustment.places.centers[chosen])
        adjustment = dataclasses.replace(adjustment, places=places)
    poses = [solution.camera_from_world[i] for i in chosen]
    if isinstance(adjustment.lens_free, list):
        adjustment = dataclasses.replace(
            adjustment, lens_free=[adjustment.lens_free[i] for i in chosen]
        )
    own = select_verified_pairs(pairs, chosen)
    return _spread_solution(
        adjust_poses(images, own, poses, options, on_step, adjustment), chosen, solution
    )


def order_by_folder(names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """Returns (N,) when images were taken, in frames, and (N,) the folder that each is in.

    Each folder holds the images of one camera, whose frames are ordered by themselves.
    """
    folders = [name.rpartition("/")[0] for name in names]
    of_image = np.array([list(dict.fromkeys(folders)).index(folder) for folder in folders])
    times = np.zeros(len(names))
    for folder in range(int(of_image.max(initial=-1)) + 1):
        own = np.flatnonzero(of_image == folder)
        times[own] = order_frames([names[int(i)] for i in own])
    return times, of_image


def list_extension_settings(
    options: PosesOptions, descriptors: Sequence[np.ndarray], cameras: Sequence[Camera]
) -> dict[str, Any]:
    """Returns the solver's settings for the extension of tracks; {} if there is none."""
    if not options.extend_rounds:
        return {}
    return {
        "descriptors": list(descriptors),
        "extend_rounds": options.extend_rounds,
        "extend_radius": options.extend_radius * measure_diagonal(cameras) / 1000,
        "extend_distance": options.extend_distance,
    }


def _make_settings(images: Images, options: PosesOptions, adjustment: Adjustment) -> dict[str, Any]:
    """Returns the settings that both ways of solving share."""
    settings: dict[str, Any] = {
        "max_error": options.max_error * measure_diagonal(images.cameras) / 1000,
        "min_angle": math.radians(options.min_angle),
        "min_inliers": options.min_inliers,
        "loss_scale": options.loss_scale,
        "hold_out_every": adjustment.hold_out_every,
        "seed": options.seed,
    }
    if adjustment.lens_free is not None:
        free = index_lenses(images.cameras, adjustment.lens_free).free
        settings["lens_free"] = [[] if f is None else [int(flag) for flag in f] for f in free]
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
        found["held_out"] if found["num_held_out"] else None, found["held_out_observations"],
    )  # fmt: skip


def _spread_solution(model: Solution, chosen: np.ndarray, whole: Solution) -> Solution:
    """Turns a solution of some images into one of all images of `whole`."""
    count = len(whole.names)

    def spread(values: np.ndarray, empty: np.ndarray) -> np.ndarray:
        result = np.repeat(empty[None], count, axis=0)
        result[chosen] = values
        return result

    observations, held = model.observations.copy(), model.held_out_observations.copy()
    for rows in (observations, held):
        rows[:, 1] = chosen[rows[:, 1]]
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
        held_out_observations=held,
    )
