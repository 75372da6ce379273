"""Refines a data set's lens together with its poses, from features of its images; no board."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from gsut._core import InputError
from gsut.data import Frame, list_some, read_dataset
from gsut.data.poses import invert_pose
from gsut.least_squares import minimize_least_squares
from gsut.lens import Camera, find_refinable_params
from gsut.sfm.core import (
    FEATURE_VARIANCE,
    Features,
    OnProgress,
    PairMatches,
    Photographs,
    PosesOptions,
    RawMatches,
    Solution,
    collect_features,
    in_cameras,
    match_images,
    refine,
    require_central,
    verify,
)
from gsut.sfm.lens.covariance import LensCovariance, lens_covariance

_FEWEST_IMAGES = 3
_HOLD_OUT_EVERY = 5  # tracks, of those long enough to spare an observation
_ROUNDS = 2  # of verified matches: the second through the refined lens
# Of the first matches' largest error: through a lens that is some percent off.
_LOOSER = 4.0
_POINT_STEPS = 20  # Levenberg-Marquardt steps of points seen by fixed cameras


@dataclasses.dataclass(frozen=True)
class RefinedLens:
    """What was found.

    Args:
        before: the data set's lens. solution: refined poses, points and lens.
        photographs: the images. covariance: of the lens.
        free: (K,) bool, parameters that were refined.
        held_out_before_px, held_out_after_px: median distance at observations that no adjustment
            used, of points triangulated from the others; through the data set's own lens and poses,
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
    """Refines the lens of a data set by bundle adjustment, starting from its lens and poses.

    Args:
        data: a data set with poses and one lens. options: see PosesOptions.
        on_progress: told (stage, done, total, text). note: told each note as it arises.

    Raises:
        InputError: no data set, several lenses, a rolling shutter, or too few images.
        SolveError: the images, lens and poses do not agree, or do not determine the lens.
    """
    frames = _checked_frames(data)
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
        note(_held_note(before, free))
    camera, poses = before, given
    loose = dataclasses.replace(options, max_two_view_error=_LOOSER * options.max_two_view_error)
    passed = 0

    def show_images(done: int, total: int, points: int, step: str) -> None:
        on_progress("adjusting", done + passed * total, _ROUNDS * total, f"{points:,} points")

    for passed in range(_ROUNDS):
        last = passed == _ROUNDS - 1
        verified = _verified(features, camera, raw, options if last else loose)
        solution = refine(
            photographs.names, [camera] * len(frames), features, verified, poses, options,
            show_images, lens_free=free, hold_out_every=_HOLD_OUT_EVERY if last else 0,
        )  # fmt: skip
        poses = solution.poses_or(poses)
        camera = solution.cameras[0]
    if solution.num_registered < len(frames):
        note(
            f"{len(frames) - solution.num_registered} of {len(frames)} images see too few points "
            f"and are left out: {list_some(solution.unregistered_names())}"
        )
    held = solution.held_out_observations
    return RefinedLens(
        before,
        solution,
        photographs,
        lens_covariance(solution, free, options.loss_scale, FEATURE_VARIANCE),
        free,
        _held_out_error(solution, features, before, given),
        _held_out_error(solution, features, camera, list(solution.camera_from_world)),
        len(held),
        float(np.max(solution.field_angles)),
    )


def _held_note(camera: Camera, free: np.ndarray) -> str:
    """Which parameters are refined, and why the others are not."""
    names = camera.param_names.split()
    refined = ", ".join(names[i] if i < len(names) else f"{i}" for i in np.flatnonzero(free))
    return (
        f"of the {camera.model} lens {refined} are refined; the other {np.count_nonzero(~free)} of "
        f"{len(free)} parameters are held: photographs without a board do not determine them"
    )


def _checked_frames(data: Path) -> list[Frame]:
    frames = sorted(read_dataset(data).frames, key=lambda frame: frame.name)
    if len(frames) < _FEWEST_IMAGES:
        raise InputError(
            f"{data} has {len(frames)} images with a pose; refining a lens needs at least "
            f"{_FEWEST_IMAGES}, better 20 or more"
        )
    lenses = list(dict.fromkeys(frame.camera for frame in frames))
    if len(lenses) > 1:
        raise InputError(
            f"{data} has {len(lenses)} lenses; --from-dataset refines one: split the data set by "
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


def _verified(
    features: Sequence[Features],
    camera: Camera,
    raw: RawMatches,
    options: PosesOptions,
) -> list[PairMatches]:
    verified = verify(features, [camera] * len(features), raw, options)
    if not verified:
        raise InputError(
            "no two images have matches that agree through this lens: do images and lens belong "
            "together?"
        )
    return verified


def _held_out_error(
    solution: Solution, features: Sequence[Features], camera: Camera, poses: list[np.ndarray]
) -> float:
    """Median pixel distance at the held-out observations, of points that the others give."""
    held = solution.held_out_observations
    if not len(held):
        return float("nan")
    used = solution.observations[np.isin(solution.observations[:, 0], held[:, 0])]
    points = fitted_points(solution.points, used, _pixels(features, used), camera, np.array(poses))
    p = in_cameras(points, held, np.array(poses))
    residuals = camera.subtract_pixels(camera.project(p)[0], _pixels(features, held))
    distance = np.linalg.norm(residuals, axis=1)
    return float(np.median(np.where(np.isfinite(distance), distance, np.inf)))


def _pixels(features: Sequence[Features], observations: np.ndarray) -> np.ndarray:
    pixels = np.zeros((len(observations), 2))
    for image in np.unique(observations[:, 1]):
        rows = observations[:, 1] == image
        pixels[rows] = features[image].pixels[observations[rows, 2]]
    return pixels


def fitted_points(
    start: np.ndarray,
    observations: np.ndarray,
    pixels: np.ndarray,
    camera: Camera,
    poses: np.ndarray,
) -> np.ndarray:
    """Points (P, 3) that fit their observations best through fixed cameras.

    Args:
        start: (P, 3). observations: (S, 3) int: point, image, feature. pixels: (S, 2) of them.
        camera: of all images. poses: (N, 4, 4) camera_from_world.
    """
    which = observations[:, 0]

    def residuals(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        p = in_cameras(points, observations, poses)
        return p, camera.subtract_pixels(camera.project(p)[0], pixels)

    def cost_of(points: np.ndarray) -> np.ndarray:
        squared = np.sum(residuals(points)[1] ** 2, axis=1)
        return np.bincount(which, np.where(np.isfinite(squared), squared, np.inf), len(points))

    def normal_equations(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        p, residual = residuals(points)
        residual = np.where(np.isfinite(residual).all(axis=1)[:, None], residual, 0.0)
        by_point = np.nan_to_num(camera.project_jacobian(p)[0]) @ poses[observations[:, 1], :3, :3]
        gradient, normal = np.zeros((len(points), 3)), np.zeros((len(points), 3, 3))
        np.add.at(gradient, which, np.einsum("nij,ni->nj", by_point, residual))
        np.add.at(normal, which, by_point.transpose(0, 2, 1) @ by_point)
        return gradient, normal

    return minimize_least_squares(start, cost_of, normal_equations, max_steps=_POINT_STEPS)[0]
