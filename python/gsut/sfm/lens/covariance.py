"""Estimates how well a lens is known: standard deviations of its parameters."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from gsut._core import SolveError
from gsut.data.poses import find_centers
from gsut.sfm.lens.information import MEDIAN_SQUARE, WeightedObservations, invert_scaled
from gsut.sfm.solution import (
    FEATURE_VARIANCE,
    LensFlags,
    Solution,
    StatedTurns,
    find_lens_prior,
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
    seen = WeightedObservations(solution, free)
    change = seen.weight * seen.by_lens
    # A body that moves during the readout: as much by its time.
    moves = solution.shutter is not None
    times = solution.measure_line_times()[seen.rows] if moves else None
    prior = _weigh_velocities(solution, seen.median) if moves else np.zeros(6)
    noise = math.sqrt(FEATURE_VARIANCE * seen.median / MEDIAN_SQUARE)
    priors = np.concatenate(
        [
            (noise / find_lens_prior(camera, flags)[1][basis.argmax(axis=0)]) ** 2
            for camera, flags, basis in zip(
                seen.lenses.cameras, seen.lenses.free, seen.bases, strict=True
            )
            if basis is not None
        ]
    )
    if turns is not None:
        turns = dataclasses.replace(
            turns, sigma=turns.sigma / noise, calibration_sigma=turns.calibration_sigma / noise
        )
        priors = np.concatenate([priors, turns.calibration_sigma**-2])
    normal, freedom = seen.find_information(lambda rows: change[rows], prior, times, turns)
    normal[np.diag_indices(len(normal))] += priors
    inverse, freedom = invert_scaled(normal), freedom - len(normal)
    if freedom <= 0 or not np.all(np.diag(inverse) > 0):
        raise SolveError(
            "these images do not determine the lens: give more of them, from different places and "
            "turned in different directions"
        )
    variance = FEATURE_VARIANCE * seen.estimate_spread(freedom)
    found, end = [], 0
    for basis in seen.bases:
        if basis is not None:
            own = slice(end, end := end + basis.shape[1])
            spread = variance * inverse[own, own]
            found.append(np.sqrt(np.einsum("kf,fg,kg->k", basis, spread, basis)))
    return found


def _weigh_velocities(solution: Solution, median: float) -> np.ndarray:
    """Returns (12,) the priors of an image's unknowns; see `_VELOCITY_SIGMA`."""
    size = np.linalg.norm(np.ptp(find_centers(solution.camera_from_world), axis=0))
    sigmas = np.repeat(_VELOCITY_SIGMA, 3) * np.repeat([size, 1.0], 3)
    return np.r_[np.zeros(6), (math.sqrt(median / 2) / sigmas) ** 2]
