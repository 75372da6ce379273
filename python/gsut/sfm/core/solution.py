"""The result of `gsut poses`, and the call of the mapper that makes it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from gsut import _core
from gsut._core import Shutter
from gsut.data.scene import order_frames
from gsut.lens import Camera
from gsut.sfm.core.features import Features
from gsut.sfm.core.matching import PairMatches
from gsut.sfm.core.moving import Moving
from gsut.sfm.core.options import PosesOptions

# Variance of what is found from photographs' features, over that which independent normal errors of
# their residuals' size would give: a feature's place changes slowly along a walk, and neighbours
# change alike, which residuals hardly show. Found on a demo scene (seed 1, 24 views: mean squared
# normalised error of the poses 33.8 for 6 degrees of freedom). With it, against exact truth: 4.9 on
# that scene, 9.0 on one of another lens and seed (12 views), 4.0 on sponza_fisheye. Poses from two
# halves of the features differ by 3.9 there, 5.0 on sponza_fisheye, 4.6 on fox: that is what the
# covariances describe. Against COLMAP's poses fox has 30: errors that all features share, of the
# lens, the shutter and the reference, are not in them.
FEATURE_VARIANCE = 5.6


@dataclasses.dataclass(frozen=True)
class Solution:
    """Poses of photographs and the points that they see.

    Args:
        names: of all images.
        cameras: the lens of each image; the estimated one where it was unknown.
        registered: (N,) bool.
        camera_from_world: (N, 4, 4) float64, OpenCV axes; identity where not registered.
        covariances: (N, 6, 6) of the centre in the world and the turn in the camera frame
            (radians, camera_from_world <- exp(turn) camera_from_world), FEATURE_VARIANCE taken
            in; 0 for what the gauge holds, NaN where not determined. Of the features' errors alone:
            those of a wrong lens or shutter are not in them.
        points: (P, 3) float64.
        colors: (P, 3) uint8, mean of the observations.
        point_errors: (P,) pixels, mean over the observations.
        observations: (S, 3) int32: point, image, feature.
        pixels: (S, 2) float64 of the observations.
        residuals: (S, 2) float64, pixels through the lens minus pixels seen.
        field_angles: (S,) radians between the observations' rays and the lens' axis.
        initial_pair: the images it began with.
        restarts: how often it began again.
        rms, median: of the residuals' lengths, in pixels.
        held_out: median length at observations that no adjustment used, in pixels; None if there
            are none.
        held_out_observations: (H, 3) int32 as `observations`: those.
        shutter: rolling, or None; camera_from_world is then that of the middle of the readout.
        velocities: (N, 6) of rolling shutters, else None: how far the centre moves in the world and
            the camera turns (radians, camera frame) during a readout.
        camera_from_body: (M, 4, 4) of a rig's mounts, else None.
    """

    names: list[str]
    cameras: list[Camera]
    registered: np.ndarray
    camera_from_world: np.ndarray
    covariances: np.ndarray
    points: np.ndarray
    colors: np.ndarray
    point_errors: np.ndarray
    observations: np.ndarray
    pixels: np.ndarray
    residuals: np.ndarray
    field_angles: np.ndarray
    initial_pair: tuple[int, int]
    restarts: int
    rms: float
    median: float
    held_out: float | None
    held_out_observations: np.ndarray
    shutter: Shutter | None = None
    velocities: np.ndarray | None = None
    camera_from_body: np.ndarray | None = None

    @property
    def num_registered(self) -> int:
        """Number of images with a pose."""
        return int(self.registered.sum())

    def poses_at(self, time: float) -> np.ndarray:
        """(N, 4, 4) camera_from_world at a time of the readout: 0 its start, 1 its end."""
        if self.velocities is None:
            return self.camera_from_world
        return np.array(
            [
                _core.moved_pose(pose, velocity, time - 0.5)
                for pose, velocity in zip(self.camera_from_world, self.velocities, strict=True)
            ]
        )

    def poses_or(self, others: Sequence[np.ndarray]) -> list[np.ndarray]:
        """(4, 4) camera_from_world of all images; where one is not registered, that of `others`."""
        return [
            found if registered else other
            for found, registered, other in zip(
                self.camera_from_world, self.registered, others, strict=True
            )
        ]

    def unregistered_names(self) -> list[str]:
        """Images without a pose."""
        return [n for n, r in zip(self.names, self.registered, strict=True) if not r]


@dataclasses.dataclass(frozen=True)
class OnRig:
    """What of a rig `refine` knows beforehand.

    Args:
        body_of_image: (N,) the rig's place that an image was taken from, from 0 without gaps.
        mount_of_image: (N,) the mount of its camera on the body; -1: the camera is the body.
        camera_from_body: (M, 4, 4) of the mounts.
        registered: (N,) bool, whether an image's pose is known; all of a body, or none.
        adjust: mounts are adjusted too; the rig keeps its size.
    """

    body_of_image: np.ndarray
    mount_of_image: np.ndarray
    camera_from_body: np.ndarray
    registered: np.ndarray
    adjust: bool = False

    def as_settings(self) -> dict[str, Any]:
        """As the solver takes it."""
        return {
            "body_of_image": self.body_of_image.tolist(),
            "mount_of_image": self.mount_of_image.tolist(),
            "camera_from_body": list(self.camera_from_body),
            "refine": self.adjust,
        }


def matches_in_points(solution: Solution, pairs: Sequence[PairMatches]) -> float:
    """Share of the verified matches, between images with poses, that observe one point.

    Above 0.9 where lens and images belong together (2 scenes), 0.3 to 0.4 with a wrong lens: pairs
    then agree one by one, but not with each other.
    """
    lengths = np.zeros(len(solution.names), np.int64)
    np.maximum.at(lengths, solution.observations[:, 1], solution.observations[:, 2] + 1)
    for pair in pairs:
        for image, features in zip((pair.first, pair.second), pair.matches.T, strict=True):
            lengths[image] = max(lengths[image], int(features.max(initial=-1)) + 1)
    points = [np.full(length, -1) for length in lengths]
    for point, image, feature in solution.observations:
        points[image][feature] = point
    together = total = 0
    for pair in pairs:
        if not (solution.registered[pair.first] and solution.registered[pair.second]):
            continue
        first = points[pair.first][pair.matches[:, 0]]
        together += int(((first >= 0) & (first == points[pair.second][pair.matches[:, 1]])).sum())
        total += len(pair.matches)
    return together / max(1, total)


def solve(
    names: Sequence[str],
    cameras: Sequence[Camera],
    features: Sequence[Features],
    pairs: Sequence[PairMatches],
    options: PosesOptions,
    on_progress: Callable[[int, int, int, str], None],
    *,
    lens_free: np.ndarray | None = None,
    lens_settled: bool = False,
    hold_out_every: int = 0,
    covariances: bool = True,
    shutter: Shutter | None = None,
) -> Solution:
    """Runs the mapper.

    Args:
        names, cameras, features: of all images.
        pairs: verified matches.
        options: see PosesOptions.
        on_progress: told (registered, images, points, step) after each step.
        lens_free: (K,) bool, which parameters of the lens are estimated too; one lens then.
        lens_settled: it is nearly right, so that it is enough to estimate it at the end.
        hold_out_every: every n-th longer track keeps one observation out of all adjustments; 0:
            none.
        covariances: False for a trial: they are left out (0), and it ends at a rougher tolerance.
        shutter: rolling, or None: all lines of an image are read at once.

    Raises:
        SolveError: nothing could be reconstructed; says why.
    """
    lenses, lens_of, settings = _inputs(cameras, options, lens_free, hold_out_every)
    settings |= {"lens_settled": lens_settled, "covariances": covariances}
    if shutter is not None:
        settings["shutter"] = shutter.direction
        settings["rolling_error"] = options.rolling_error
        if options.readout_time is not None:
            settings["readout_time"] = options.readout_time
            settings["frame_times"] = order_frames(names).tolist()
    if not hold_out_every:
        settings.update(_extension(options, features, lenses))
    found = _core.estimate_poses(
        lenses, lens_of, [f.pixels for f in features],
        [p.as_tuple() for p in pairs], settings, on_progress,
    )  # fmt: skip
    solution = _solution(names, cameras, features, found, lens_free is not None)
    if shutter is None:
        return solution
    return dataclasses.replace(solution, shutter=shutter, velocities=found["velocities"])


def refine(
    names: Sequence[str],
    cameras: Sequence[Camera],
    features: Sequence[Features],
    pairs: Sequence[PairMatches],
    camera_from_world: Sequence[np.ndarray],
    options: PosesOptions,
    on_progress: Callable[[int, int, int, str], None],
    *,
    lens_free: np.ndarray | None = None,
    hold_out_every: int = 0,
    covariances: bool = True,
    on_rig: OnRig | None = None,
    moving: Moving | None = None,
) -> Solution:
    """Refines poses and points, and the lens if asked for, that are roughly right.

    Args:
        camera_from_world: (4, 4) poses, one an image; their world is kept.
        on_rig: the images' cameras are fixed to each other; tracks are extended then too.
        moving: images are read line by line, each with a velocity of its own.
        others: as for `solve`.

    Raises:
        SolveError: too few points agree with the poses.
    """
    lenses, lens_of, settings = _inputs(cameras, options, lens_free, hold_out_every)
    settings["covariances"] = covariances
    known: list[int] = []
    if on_rig is not None:
        known = on_rig.registered.astype(int).tolist()
    if moving is not None:
        settings.update(moving.as_settings())
    if on_rig is not None or (moving is not None and moving.extend):
        settings.update(_extension(options, features, lenses))
    found = _core.refine_structure(
        lenses, lens_of, [f.pixels for f in features],
        [p.as_tuple() for p in pairs], list(camera_from_world), settings, on_progress,
        known, None if on_rig is None else on_rig.as_settings(),
    )  # fmt: skip
    solution = _solution(names, cameras, features, found, lens_free is not None)
    if on_rig is not None:
        solution = dataclasses.replace(
            solution, camera_from_body=np.array(found["camera_from_body"])
        )
    if moving is None:
        return solution
    return dataclasses.replace(solution, shutter=moving.shutter, velocities=found["velocities"])


def _inputs(
    cameras: Sequence[Camera],
    options: PosesOptions,
    lens_free: np.ndarray | None,
    hold_out_every: int,
) -> tuple[list[Camera], list[int], dict[str, Any]]:
    """Lenses, the lens of each image, and the solver's settings."""
    lenses = list(dict.fromkeys(cameras))
    settings: dict[str, Any] = {
        "max_error": options.max_error * diagonal(lenses) / 1000,
        "min_angle": math.radians(options.min_angle),
        "min_inliers": options.min_inliers,
        "loss_scale": options.loss_scale,
        "hold_out_every": hold_out_every,
        "seed": options.seed,
    }
    if lens_free is not None:
        settings["lens_free"] = [[int(flag) for flag in lens_free] for _ in lenses]
    return lenses, [lenses.index(c) for c in cameras], settings


def _extension(
    options: PosesOptions, features: Sequence[Features], lenses: Sequence[Camera]
) -> dict[str, Any]:
    """The solver's settings for longer tracks."""
    if not options.extend_rounds:
        return {}
    return {
        "descriptors": [f.descriptors for f in features],
        "extend_rounds": options.extend_rounds,
        "extend_radius": options.extend_radius * diagonal(lenses) / 1000,
        "extend_distance": options.extend_distance,
    }


def _solution(
    names: Sequence[str],
    cameras: Sequence[Camera],
    features: Sequence[Features],
    found: dict[str, Any],
    lens_free: bool,
) -> Solution:
    if found["failure"]:
        raise _core.SolveError(found["failure"])
    if not np.any(found["registered"]):
        raise _core.SolveError("no image holds its points once poses are adjusted")
    lenses = list(dict.fromkeys(cameras))
    solved = [
        c.with_params(p) if lens_free else c
        for c, p in zip(lenses, found["lens_params"], strict=True)
    ]
    own = [solved[lenses.index(c)] for c in cameras]
    observations = found["observations"]
    pixels, residuals, angles = evaluate_observations(
        observations, found["observations_in_camera"], own, features
    )
    colors = mean_colors(observations, len(found["points"]), [f.colors for f in features])
    return Solution(
        list(names), own, found["registered"], found["camera_from_world"],
        FEATURE_VARIANCE * found["covariances"],
        found["points"], colors, found["point_errors"], observations, pixels, residuals, angles,
        found["initial_pair"], found["restarts"], found["rms"], found["median"],
        found["held_out"] if found["num_held_out"] else None, found["held_out_observations"],
    )  # fmt: skip


def diagonal(cameras: Sequence[Camera]) -> float:
    """Of the largest image, in pixels."""
    return max(math.hypot(c.width, c.height) for c in cameras)


def in_cameras(
    points: np.ndarray, observations: np.ndarray, camera_from_world: np.ndarray
) -> np.ndarray:
    """(S, 3) the points of observations (S, 3: point, image, feature) in their images' cameras."""
    pose = camera_from_world[observations[:, 1]]
    return np.einsum("nij,nj->ni", pose[:, :3, :3], points[observations[:, 0]]) + pose[:, :3, 3]


def evaluate_observations(
    observations: np.ndarray,
    in_camera: np.ndarray,
    cameras: Sequence[Camera],
    features: Sequence[Features],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pixels (S, 2), residuals (S, 2) and field angles (S,) of observations, as in `Solution`.

    Args:
        observations: (S, 3) point, image, feature.
        in_camera: (S, 3) the points in the images' cameras.
        cameras, features: of all images.
    """
    pixels = np.zeros((len(observations), 2))
    residuals = np.full((len(observations), 2), np.nan)
    for image in np.unique(observations[:, 1]):
        rows = observations[:, 1] == image
        pixels[rows] = features[image].pixels[observations[rows, 2]]
        camera = cameras[image]
        found, _ = camera.project(in_camera[rows])
        residuals[rows] = camera.subtract_pixels(found, pixels[rows])
    angles = np.arctan2(np.hypot(in_camera[:, 0], in_camera[:, 1]), in_camera[:, 2])
    return pixels, residuals, angles


def mean_colors(
    observations: np.ndarray, points: int, of_images: Sequence[np.ndarray]
) -> np.ndarray:
    """(P, 3) uint8, mean over each point's observations of colours (N, 3) of each image."""
    colors = np.zeros((points, 3))
    for image in np.unique(observations[:, 1]):
        rows = observations[:, 1] == image
        np.add.at(colors, observations[rows, 0], of_images[image][observations[rows, 2]])
    counts = np.bincount(observations[:, 0], minlength=points).clip(1)
    return np.rint(colors / counts[:, None]).astype(np.uint8)
