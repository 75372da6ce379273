"""Refines a dataset's lens and poses from features of its images, without a board."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from gsut._core import InputError
from gsut.data import Frame, list_some, read_dataset
from gsut.data.poses import invert_pose
from gsut.least_squares import minimize_least_squares
from gsut.lens import Camera, find_refinable_params
from gsut.sfm.lens.covariance import LensCovariance, estimate_lens_covariances
from gsut.sfm.matches import match_images, verify_matches
from gsut.sfm.photographs import (
    Features,
    Images,
    OnProgress,
    Photographs,
    PosesOptions,
    collect_features,
    require_central,
)
from gsut.sfm.solution import (
    FEATURE_VARIANCE,
    Adjustment,
    Solution,
    adjust_poses,
    gather_pixels,
    transform_to_cameras,
)

_FEWEST_IMAGES = 3  # with a pose: two leave the lens open
_HOLD_OUT_EVERY = 5  # tracks, of those long enough to spare an observation
_ROUNDS = 2  # of verifying matches: the second through the refined lens
_LOOSER = 4.0  # on the largest error of the first round, through a lens that is some percent off
_POINT_STEPS = 20  # Levenberg-Marquardt steps of points seen by fixed cameras


@dataclasses.dataclass(frozen=True)
class RefinedLens:
    """A refined lens and how well it is known.

    Args:
        before: the dataset's lens.
        solution: refined poses, points and lens.
        photographs: the images.
        covariance: of the lens.
        free: (K,) bool, the refined parameters.
        held_out_before_px, held_out_after_px: median distance at observations that no adjustment
            used, of points triangulated from the others; through the dataset's own lens and poses,
            and through the refined ones.
        held_out: number of those observations.
        reach: radians from the axis to the outermost observation.
    """

    before: Camera
    solution: Solution
    photographs: Photographs
    covariance: LensCovariance
    free: np.ndarray
    held_out_before_px: float
    held_out_after_px: float
    held_out: int
    reach: float

    @property
    def camera(self) -> Camera:
        """The refined lens."""
        return self.solution.cameras[0]


def refine_lens(
    data: Path, options: PosesOptions, on_progress: OnProgress, note: Callable[[str], None]
) -> RefinedLens:
    """Refines the lens of a dataset by bundle adjustment, starting from its lens and poses.

    Args:
        data: a dataset with poses and one lens.
        on_progress: called with (stage, done, total, text).
        note: called with each note as it arises.

    Raises:
        InputError: no dataset, several lenses, a rolling shutter, or too few images.
        SolveError: the images, lens and poses do not agree, or do not determine the lens.
    """
    frames = _read_frames(data)
    before = frames[0].camera
    photographs = Photographs(
        data if data.is_dir() else data.parent,
        [frame.name for frame in frames],
        [frame.image_path for frame in frames],
        [frame.mask_path for frame in frames],
        [frame.camera for frame in frames],
    )
    given = [invert_pose(frame.world_from_camera) for frame in frames]
    features = collect_features(photographs, options, on_progress, note)
    raw = match_images(photographs.names, features, options, on_progress)
    free = find_refinable_params(before)
    if not free.all():
        note(_describe_held(before, free))
    camera, poses = before, given
    loose = dataclasses.replace(options, max_two_view_error=_LOOSER * options.max_two_view_error)
    passed = 0

    def show_images(done: int, total: int, points: int, *_: object) -> None:
        on_progress("adjusting", done + passed * total, _ROUNDS * total, f"{points:,} points")

    for passed in range(_ROUNDS):
        last = passed == _ROUNDS - 1
        images = Images(photographs.names, [camera] * len(frames), features)
        verified = verify_matches(images, raw, options if last else loose)
        if not verified:
            raise InputError(
                "no two images have matches that agree through this lens: do images and lens "
                "belong together?"
            )
        hold_out = _HOLD_OUT_EVERY if last else 0
        adjustment = Adjustment(free, hold_out_every=hold_out, center_sigma=math.inf)
        solution = adjust_poses(images, verified, poses, options, show_images, adjustment)
        poses = solution.fill_poses(poses)
        camera = solution.cameras[0]
    if solution.num_registered < len(frames):
        note(
            f"{len(frames) - solution.num_registered} of {len(frames)} images see too few points "
            f"and are left out: {list_some(solution.unregistered_names)}"
        )
    held = solution.held_out_observations
    return RefinedLens(
        before,
        solution,
        photographs,
        estimate_lens_covariances(
            solution, free, options.loss_scale, FEATURE_VARIANCE, center_sigma=math.inf
        )[0],
        free,
        _measure_held_out(solution, features, before, given),
        _measure_held_out(solution, features, camera, list(solution.camera_from_world)),
        len(held),
        float(np.max(solution.field_angles)),
    )


def _describe_held(camera: Camera, free: np.ndarray) -> str:
    """Describes which parameters are refined, and why the others are not."""
    names = camera.param_names.split()
    refined = ", ".join(names[i] if i < len(names) else f"{i}" for i in np.flatnonzero(free))
    return (
        f"of the {camera.model} lens {refined} are refined; the other {np.count_nonzero(~free)} of "
        f"{len(free)} parameters are held: photographs without a board do not determine them"
    )


def _read_frames(data: Path) -> list[Frame]:
    frames = sorted(read_dataset(data).frames, key=lambda frame: frame.name)
    if len(frames) < _FEWEST_IMAGES:
        raise InputError(
            f"{data} has {len(frames)} images with a pose; refining a lens needs at least "
            f"{_FEWEST_IMAGES}, better 20 or more"
        )
    lenses = list(dict.fromkeys(frame.camera for frame in frames))
    if len(lenses) > 1:
        raise InputError(
            f"{data} has {len(lenses)} lenses; --from-dataset refines one: split the dataset by "
            "lens"
        )
    if any(frame.shutter is not None for frame in frames):
        raise InputError(
            f"{data} has a rolling shutter, which --from-dataset does not model; calibrate with a "
            "board and a still camera"
        )
    require_central(lenses)
    if not lenses[0].params.size:
        raise InputError(f"{data}: the lens {lenses[0].model} has no parameters to refine")
    return frames


def _measure_held_out(
    solution: Solution, features: Sequence[Features], camera: Camera, poses: list[np.ndarray]
) -> float:
    """Returns the median pixel distance at held-out observations of points that the others give."""
    held = solution.held_out_observations
    if not len(held):
        return float("nan")
    used = solution.observations[np.isin(solution.observations[:, 0], held[:, 0])]
    points = fit_points(
        solution.points, used, gather_pixels(features, used), camera, np.array(poses)
    )
    p = transform_to_cameras(points, held, np.array(poses))
    residuals = camera.subtract_pixels(camera.project(p)[0], gather_pixels(features, held))
    distance = np.linalg.norm(residuals, axis=1)
    return float(np.median(np.where(np.isfinite(distance), distance, np.inf)))


def fit_points(
    start: np.ndarray,
    observations: np.ndarray,
    pixels: np.ndarray,
    camera: Camera,
    poses: np.ndarray,
) -> np.ndarray:
    """Fits points (P, 3) to their observations through fixed cameras.

    Args:
        start: (P, 3) points.
        observations: (S, 3) int: point, image, feature.
        pixels: (S, 2) of the observations.
        camera: of all images.
        poses: (N, 4, 4) camera_from_world.
    """
    which = observations[:, 0]

    def measure_residuals(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        p = transform_to_cameras(points, observations, poses)
        return p, camera.subtract_pixels(camera.project(p)[0], pixels)

    def measure_cost(points: np.ndarray) -> np.ndarray:
        squared = np.sum(measure_residuals(points)[1] ** 2, axis=1)
        return np.bincount(which, np.where(np.isfinite(squared), squared, np.inf), len(points))

    def build_normal_equations(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        p, residual = measure_residuals(points)
        residual = np.where(np.isfinite(residual).all(axis=1)[:, None], residual, 0.0)
        by_p, _ = camera.project_jacobian(p, with_params=False)
        by_point = np.nan_to_num(by_p) @ poses[observations[:, 1], :3, :3]
        gradient, normal = np.zeros((len(points), 3)), np.zeros((len(points), 3, 3))
        np.add.at(gradient, which, np.einsum("nij,ni->nj", by_point, residual))
        np.add.at(normal, which, by_point.transpose(0, 2, 1) @ by_point)
        return gradient, normal

    return minimize_least_squares(
        start, measure_cost, build_normal_equations, max_steps=_POINT_STEPS
    )[0]
