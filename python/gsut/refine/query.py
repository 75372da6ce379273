"""One photograph against a scene: from a start to a pose, its lines and an honest covariance."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from gsut._core import InputError, Shutter, SolveError
from gsut.gaussians import Gaussians
from gsut.refine.pixel_rows import (
    SCENE_BLOCKS,
    compute_square,
    estimate_covariance,
    estimate_step,
    measure_unmodelled_motion,
)
from gsut.refine.pose import (
    LEVELS_WITH_MOTION,
    CoarsePose,
    Photograph,
    RefinedPose,
    check_photograph,
    make_refined_pose,
)
from gsut.refine.secants import SecantPose, place_lines
from gsut.render import render

# Standard deviations grow by this power of the share of the photograph that counts, as fewer parts
# of the scene are averaged.
_BY_SHARE = -1 / 3
# Logarithms of the factors on the focal length that are tried, upwards or downwards, until two fit
# worse than the best.
_FOCAL_STEPS = (0.025, 0.06, 0.12, 0.25, 0.5, 0.75)
# Error of the logarithm that small pictures do not show: half of the first step.
_FOCAL_BLUR = 0.0125
# Step of the logarithm of the focal length on either side of a difference of renders.
_FOCAL_DIFFERENCE = 1e-3
# Standard deviations, those of noise, from which an error of the focal length counts: a large one
# turns into distance, and little of it shows.
_FOCAL_CLEAR = 2.5
# Sizes of the photograph, the full one included, by which starts and focal lengths are compared.
_LEVELS = 4
# Size from which a pose and a motion that fit matches are refined: they are off by a pixel or so.
_LEVEL_OF_MATCHES = 1
# Finest size by which focal lengths are compared under a rolling shutter: smaller ones hardly show
# the motion, which is not modelled there.
_LEVEL_WITHOUT_MOTION = 2
# Largest number of pixels compared.
_PIXELS = 20_000
# Square of the motion that a global pose leaves over, per unknown and by the noise alone, from
# which lines are posed: errors of a scene reach 3.
_MOTION_SUSPECTED = 3.5
# Square of the motion itself from which it is beyond doubt: scenes err by several standard
# deviations here and there.
_MOTION_CLEAR = 30.0
# Ratio of a picture's sides from which it shows how the sensor was held.
_OBLONG = 1.2


@dataclasses.dataclass(frozen=True)
class Query:
    """A photograph that is compared with a scene about its origin.

    Args:
        gaussians, camera, background: see `localize_image`.
        pixels: (H, W, 3) float32, 0 to 1. valid: (H, W) bool, of the pixels that count.
    """

    gaussians: Gaussians
    camera: Any
    pixels: np.ndarray
    valid: np.ndarray
    background: Sequence[float]

    @classmethod
    def prepare(
        cls,
        gaussians: Gaussians,
        camera: Any,
        pixels: np.ndarray,
        mask: np.ndarray,
        background: Sequence[float],
    ) -> Query:
        """Checks the photograph."""
        seen, valid = check_photograph(camera, pixels, mask)
        return cls(gaussians.to_dtype(np.float32), camera, seen, valid, background)

    @property
    def _widening(self) -> float:
        """Returns the factor on standard deviations where only a part of the image counts."""
        return float(np.mean(self.valid)) ** _BY_SHARE

    def refine_smaller(self, camera: Any, pose: np.ndarray, finest: int = 1) -> CoarsePose:
        """Refines a pose with the photograph halved `finest` times and more, through this lens."""
        return self._make_photograph(camera).refine_coarsely(pose, range(finest, _LEVELS), True)

    def _make_photograph(self, camera: Any) -> Photograph:
        valid = self.valid & camera.rays()[1]
        return Photograph(
            self.gaussians, camera, self.pixels, valid, tuple(self.background), _PIXELS
        )

    def refine_lines(
        self, pose: np.ndarray, shutter: Shutter | None, motion: np.ndarray | None = None
    ) -> tuple[SecantPose, Shutter | None, str]:
        """Refines a pose with the whole photograph, with the shutter given or the one it shows.

        Args:
            pose: (4, 4) start. shutter: None: found. motion: (6,) start under a rolling shutter.
        """
        if shutter is not None and not shutter.is_global:
            return self._refine(pose, shutter, motion), shutter, "given"
        still = self._refine(pose)
        if shutter is not None:
            return still, None, "given"
        suspected = [
            each
            for each in list_likely_shutters(self.camera)
            if measure_unmodelled_motion(still.rows, each) > _MOTION_SUSPECTED * self._widening**2
        ]
        if not suspected:
            return still, None, "picture"
        # Two directions look alike in differences of a fraction of a pixel; the colours decide.
        tried = [(self._refine(pose, each), each) for each in suspected]
        moved, likely = min(tried, key=lambda each: each[0].rms)
        refined = make_refined_pose(moved, likely, np.zeros(3))
        square = compute_square(moved.motion, np.asarray(refined.motion_covariance))
        if moved.rms < still.rms and square > _MOTION_CLEAR * self._widening**2:
            return moved, likely, "picture"
        return still, None, "undetermined"

    def _refine(
        self, pose: np.ndarray, shutter: Shutter | None = None, motion: np.ndarray | None = None
    ) -> SecantPose:
        """Refines a pose that fits the smaller sizes; motion moves it, so these come again."""
        photograph = self._make_photograph(self.camera)
        if shutter is not None:
            start = CoarsePose(pose, motion=motion)
            first = LEVELS_WITH_MOTION - 1 if motion is None else _LEVEL_OF_MATCHES
            return photograph.refine_finely(start, first, True, shutter)
        coarse = photograph.refine_coarsely(pose, range(1), True)
        return photograph.refine_finely(coarse, 0, True, None)

    def add_systematic_errors(
        self, fine: SecantPose, shutter: Shutter | None, source: str
    ) -> tuple[RefinedPose, float]:
        """Adds to the covariance what the scene errs by, a wrong focal length, a doubtful shutter.

        Returns:
            The pose, and the factor on the focal length with which the colours fit best.

        Raises:
            SolveError: no focal length that is at all near fits.
        """
        pose = make_refined_pose(fine, shutter, np.zeros(3), SCENE_BLOCKS)
        wide = self._widening**2
        covariance = wide * pose.covariance
        if source == "undetermined":
            moved = max(
                (self._measure_shift_by_motion(fine, each) for each in
                 list_likely_shutters(self.camera)),
                key=lambda shift: compute_square(shift, covariance),
            )  # fmt: skip
            covariance = covariance + np.outer(moved, moved)
        best = 0.0
        if self.camera.param_names.split()[:2] == ["fx", "fy"]:
            off, sigma = self._measure_focal_error(fine, shutter)
            if abs(off) > _FOCAL_CLEAR * self._widening * sigma:
                finest = 1 if shutter is None else _LEVEL_WITHOUT_MOTION
                best, moved = self._try_focal_lengths(fine.camera_from_world, np.sign(off), finest)
                if abs(best) >= _FOCAL_STEPS[-1]:
                    raise SolveError(
                        "the photograph was not found in the scene: its colours would fit a focal "
                        f"length times {np.exp(best):.1f} or beyond; another lens took it: give "
                        "its own with --camera"
                    )
                covariance = covariance + np.outer(moved, moved)
        if pose.motion_covariance is not None:
            pose = dataclasses.replace(pose, motion_covariance=wide * pose.motion_covariance)
        return dataclasses.replace(pose, covariance=covariance), float(np.exp(best))

    def _measure_shift_by_motion(self, fine: SecantPose, shutter: Shutter) -> np.ndarray:
        """Measures (6,) how far the pose would move if the shutter were rolling."""
        return estimate_step(fine.rows, fine.rows.stack_slopes(shutter))[:6]

    def _measure_focal_error(
        self, fine: SecantPose, shutter: Shutter | None
    ) -> tuple[float, float]:
        """Measures the logarithm of the factor on the focal length, and its standard deviation."""
        where = place_lines(fine.camera_from_world, fine.motion, shutter)
        sides = [
            render(self.gaussians, _scale_focal_length(self.camera, step), where,
                   background=self.background).image.reshape(-1, 3)[fine.rows.pixels]
            for step in (_FOCAL_DIFFERENCE, -_FOCAL_DIFFERENCE)
        ]  # fmt: skip
        by_focal = fine.gain[0] * (sides[0] - sides[1]).astype(np.float64) / (2 * _FOCAL_DIFFERENCE)
        slopes = np.concatenate([fine.rows.stack_slopes(shutter), by_focal[:, :, None]], axis=2)
        covariance = estimate_covariance(fine.rows, slopes)
        return float(estimate_step(fine.rows, slopes)[-1]), float(np.sqrt(covariance[-1, -1]))

    def _try_focal_lengths(
        self, start: np.ndarray, sign: float, finest: int
    ) -> tuple[float, np.ndarray]:
        """Finds the best factor on the focal length (logarithm), and how far the pose moves."""
        tried: dict[float, CoarsePose] = {}
        for step in (0.0, *(sign * size for size in _FOCAL_STEPS)):
            with contextlib.suppress(InputError, SolveError):
                tried[step] = self.refine_smaller(
                    _scale_focal_length(self.camera, step), start, finest
                )
            left = [each.rms for each in tried.values()]
            if left and np.argmin(left) < len(left) - 2:
                break
        return _fit_focal_length(tried)


def list_likely_shutters(camera: Any) -> list[Shutter]:
    """Lists shutters whose lines run along the longer side, or both ways if neither is longer.

    Of each pair that only differ by the order of the lines one stands for both: the motion has a
    sign.
    """
    both = [Shutter("top_to_bottom"), Shutter("left_to_right")]
    width, height = camera.width, camera.height
    if max(width, height) < _OBLONG * min(width, height):
        return both
    return both[:1] if width > height else both[1:]


def _scale_focal_length(camera: Any, step: float) -> Any:
    """Multiplies the focal lengths by the exponential of `step`."""
    params = np.array(camera.params)
    params[:2] *= np.exp(step)
    return camera.with_params(params)


def _fit_focal_length(tried: dict[float, CoarsePose]) -> tuple[float, np.ndarray]:
    """Finds the focal length with which colours differ least, and how far the pose moves with it.

    Fits a parabola through the best attempt and its neighbours.

    Returns:
        The logarithm of the factor on the focal length, and (6,) the change of the pose with it, or
        with the error that small pictures do not show if that is larger.
    """
    steps = sorted(tried)
    squares = np.array([tried[step].rms ** 2 for step in steps])
    least = int(np.argmin(squares))
    best = steps[least]
    if 0 < least < len(steps) - 1:
        near = slice(least - 1, least + 2)
        bend, slope, _ = np.polyfit(steps[near], squares[near], 2)
        best = float(np.clip(-slope / (2 * bend), steps[least - 1], steps[least + 1]))
    if len(steps) < 2 or 0.0 not in tried:
        return 0.0, np.zeros(6)
    middle = tried[0.0].camera_from_world
    poses = np.array([subtract_poses(tried[step].camera_from_world, middle) for step in steps])
    far = best if abs(best) > _FOCAL_BLUR else np.copysign(_FOCAL_BLUR, steps[0] + steps[-1])
    return best, np.array([np.interp(far, steps, column) for column in poses.T])


def subtract_poses(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Returns (6,) the change of centre (world axes) and small rotation vector (camera axes)."""
    turn = one[:3, :3] @ other[:3, :3].T
    vector = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    centers = [-pose[:3, :3].T @ pose[:3, 3] for pose in (one, other)]
    return np.concatenate([centers[0] - centers[1], vector / 2])
