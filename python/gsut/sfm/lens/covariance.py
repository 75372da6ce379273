"""Estimates how well a lens is known: standard deviations of its parameters."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from gsut._core import SolveError
from gsut.data.poses import find_centers
from gsut.lens import Camera, find_focal_params
from gsut.sfm.lens.information import GROUPS, MEDIAN_SQUARE, WeightedObservations, invert_scaled
from gsut.sfm.solution import (
    FEATURE_VARIANCE,
    LensFlags,
    Solution,
    StatedTurns,
    find_lens_prior,
    index_lenses,
)

# Standard deviations of an image's shift, over the extent of the cameras, and of its turn in
# radians during a readout: as in the adjustment.
_VELOCITY_SIGMA = (0.1, 0.2)


def estimate_lens_sigmas(
    solution: Solution, free: LensFlags, turns: StatedTurns | None = None
) -> list[np.ndarray]:
    """Estimates standard deviations (K,) of each estimated lens's parameters, 0 if held.

    By the inverse of the normal equations with poses and points eliminated, times a variance that
    takes in what Cauchy's loss costs.

    Args:
        solution: poses and points, of features of photographs; see FEATURE_VARIANCE.
        free: flags of the adjusted parameters, see `Adjustment`.
        turns: see `Adjustment`.

    Raises:
        SolveError: the observations do not determine the lens.
    """
    equations = _Equations(solution, free, turns)
    normal, _, freedom = equations.reduce()
    inverse, freedom = invert_scaled(normal), freedom - len(normal)
    if freedom <= 0 or not np.all(np.diag(inverse) > 0):
        raise SolveError(
            "these images do not determine the lens: give more of them, from different places and "
            "turned in different directions"
        )
    variance = FEATURE_VARIANCE * equations.seen.estimate_spread(freedom)
    variance *= 1.0 if turns is None else turns.shared
    return [
        np.sqrt(np.einsum("kf,fg,kg->k", basis, variance * inverse[own, own], basis))
        for _, basis, own in equations.list_lenses()
    ]


def measure_focal_sigma(
    solution: Solution, flags: LensFlags, turns: StatedTurns | None = None
) -> tuple[float, list[np.ndarray]]:
    """Measures the relative standard deviation of the focal length of the least known lens.

    Returns:
        It, infinite where the images do not determine the lens; and standard deviations of the
        lenses' parameters.
    """
    try:
        sigmas = estimate_lens_sigmas(solution, flags, turns)
    except SolveError:
        return math.inf, []
    lenses = index_lenses(solution.cameras, flags)
    estimated = [c for c, f in zip(lenses.cameras, lenses.free, strict=True) if f is not None]
    sigma = max(float(own[0] / lens.params[0]) for own, lens in zip(sigmas, estimated, strict=True))
    return sigma, sigmas


def estimate_focal_spread(
    solution: Solution, free: LensFlags, turns: StatedTurns | None = None
) -> float:
    """Estimates how much focal lengths vary when one group of images after the other is left out.

    The jackknife, which shows what features share: a shutter, a lens of another shape, wrong
    matches. Each time lenses, poses and points make the step of Newton that the other images'
    observations demand.

    Args:
        solution, free, turns: see `estimate_lens_sigmas`.

    Returns:
        Standard deviation of the logarithm, of the lens that varies most; infinite where a focal
        length is found fewer than twice.
    """
    equations, images = _Equations(solution, free, turns), np.flatnonzero(solution.registered)
    _, balance, _ = equations.reduce()  # of priors, and of what observations pull at
    steps = []
    for group in np.array_split(images, min(GROUPS, len(images))):
        normal, pull, _ = equations.reduce(group)
        seen = np.flatnonzero(pull)  # all but those of lenses whose images are all left out
        step = np.full(len(pull), np.nan)
        step[seen] = invert_scaled(normal[np.ix_(seen, seen)]) @ (balance - pull)[seen]
        step /= equations.seen.curvature
        row = []
        for camera, basis, own in equations.list_lenses():
            focal = find_focal_params(camera)[0]
            row.append(basis[focal] @ np.where(basis[focal], step[own], 0.0) / camera.params[focal])
        steps.append(row)
    found = [column[np.isfinite(column)] for column in np.array(steps).T]
    return max(
        math.sqrt((len(each) - 1) * float(np.var(each))) if len(each) > 1 else math.inf
        for each in found
    )


class _Equations:
    """Normal equations of lenses, from which poses and points are eliminated.

    Args:
        solution, free, turns: see `estimate_lens_sigmas`.
    """

    def __init__(self, solution: Solution, free: LensFlags, turns: StatedTurns | None) -> None:
        self.seen = seen = WeightedObservations(solution, free)
        residuals = solution.residuals[seen.rows, :, None]
        self._columns = seen.weight * np.concatenate([seen.by_lens, residuals], axis=2)
        # A body that moves during the readout: as much by its time.
        moves = solution.shutter is not None
        self._times = solution.measure_line_times()[seen.rows] if moves else None
        self._prior = _weigh_velocities(solution, seen.median) if moves else np.zeros(6)
        shared = FEATURE_VARIANCE * (1.0 if turns is None else turns.shared)
        noise = math.sqrt(shared * seen.median / MEDIAN_SQUARE)
        lenses = zip(seen.lenses.cameras, seen.lenses.free, seen.bases, strict=True)
        sigmas = [
            _find_lens_sigmas(camera, flags)[basis.argmax(axis=0)]
            for camera, flags, basis in lenses
            if basis is not None
        ]
        if turns is not None:
            sigmas.append(turns.calibration_sigma)
            turns = dataclasses.replace(
                turns, sigma=turns.sigma / noise, calibration_sigma=turns.calibration_sigma / noise
            )
        self._turns, self._priors = turns, (noise / np.concatenate(sigmas)) ** 2

    def list_lenses(self) -> list[tuple[Camera, np.ndarray, slice]]:
        """Lists the estimated lenses, what turns their unknowns into all parameters, and these."""
        found, end = [], 0
        for camera, basis in zip(self.seen.lenses.cameras, self.seen.bases, strict=True):
            if basis is not None:
                found.append((camera, basis, slice(end, end := end + basis.shape[1])))
        return found

    def reduce(
        self, left_out: Sequence[int] | np.ndarray = ()
    ) -> tuple[np.ndarray, np.ndarray, int]:
        """Returns normal equations (F, F), their right side (F,), and see `find_information`.

        Args:
            left_out: images that do not count.
        """
        table, freedom = self.seen.find_information(
            lambda rows: self._columns[rows], self._prior, self._times, self._turns, left_out
        )
        residual = self._columns.shape[2] - 1
        kept = np.delete(np.arange(len(table)), residual)
        normal = table[np.ix_(kept, kept)]
        normal[np.diag_indices(len(normal))] += self._priors
        return normal, table[kept, residual], freedom


def _find_lens_sigmas(camera: Camera, flags: np.ndarray | None) -> np.ndarray:
    """Finds standard deviations (K,) of a lens's parameters beforehand, in their own units."""
    sigma = find_lens_prior(camera, flags)[1]
    sigma[0] *= camera.params[0]
    return sigma


def _weigh_velocities(solution: Solution, median: float) -> np.ndarray:
    """Returns (12,) the priors of an image's unknowns; see `_VELOCITY_SIGMA`."""
    size = np.linalg.norm(np.ptp(find_centers(solution.camera_from_world), axis=0))
    sigmas = np.repeat(_VELOCITY_SIGMA, 3) * np.repeat([size, 1.0], 3)
    return np.r_[np.zeros(6), (math.sqrt(median / 2) / sigmas) ** 2]
