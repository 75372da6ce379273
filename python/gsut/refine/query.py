"""One photograph against a scene: from a start to a pose, its lines and an honest covariance."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from gsut._core import Shutter
from gsut.gaussians import Gaussians
from gsut.refine.agreement import COMPARED_PIXELS
from gsut.refine.focal import measure_focal_error
from gsut.refine.pixel_rows import (
    SCENE_BLOCKS,
    compute_square,
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
from gsut.refine.secants import SecantPose
from gsut.sfm.shutter import list_likely_shutters

# Standard deviations grow by this power of the share of the photograph that counts, as fewer parts
# of the scene are averaged.
_BY_SHARE = -1 / 3
# Sizes of the photograph, the full one included, by which starts are compared and focal lengths are
# found.
_LEVELS = 4
# Size from which a pose and a motion that fit matches are refined: they are off by a pixel or so.
_LEVEL_OF_MATCHES = 1
# Finest size by which a focal length is found under a rolling shutter: smaller ones hardly show the
# motion, which is not modelled there.
_LEVEL_WITHOUT_MOTION = 2
# Pixels along the shorter side below which a focal length is found with the whole photograph.
_SMALL_SIDE = 96
# Square of the motion that a global pose leaves over, per unknown and by the noise alone, from
# which lines are posed: errors of a scene reach 3.
_MOTION_SUSPECTED = 3.5
# Square of the motion itself from which it is beyond doubt: scenes err by several standard
# deviations here and there.
_MOTION_CLEAR = 30.0


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

    @property
    def _photograph(self) -> Photograph:
        return Photograph(
            self.gaussians, self.camera, self.pixels, self.valid, tuple(self.background),
            COMPARED_PIXELS, SCENE_BLOCKS,
        )  # fmt: skip

    def refine_smaller(self, pose: np.ndarray) -> CoarsePose:
        """Refines a pose with the photograph at half its size and less."""
        return self._photograph.refine_coarsely(pose, range(1, _LEVELS), True)

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
        photograph = self._photograph
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
            finest = 1 if shutter is None else _LEVEL_WITHOUT_MOTION
            if min(self.camera.width, self.camera.height) < _SMALL_SIDE:
                finest = 0
            best, moved = measure_focal_error(
                self._photograph, fine, shutter, self._widening, range(finest, _LEVELS)
            )
            covariance = covariance + np.outer(moved, moved)
        if pose.motion_covariance is not None:
            pose = dataclasses.replace(pose, motion_covariance=wide * pose.motion_covariance)
        return dataclasses.replace(pose, covariance=covariance), float(np.exp(best))

    def _measure_shift_by_motion(self, fine: SecantPose, shutter: Shutter) -> np.ndarray:
        """Measures (6,) how far the pose would move if the shutter were rolling."""
        return estimate_step(fine.rows, fine.rows.stack_slopes(shutter))[:6]
