"""Estimates how well a lens is known: the covariance of its parameters and projections."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from gsut._core import SolveError
from gsut.data.poses import find_centers
from gsut.lens import Camera
from gsut.sfm.lens.information import (
    MEDIAN_SQUARE,
    WeightedObservations,
    differentiate_by_turn,
    invert_scaled,
)
from gsut.sfm.solution import CENTER, Adjustment, LensFlags, Solution, StatedTurns

# Standard deviations of an image's shift, over the extent of the cameras, and of its turn in
# radians during a readout: as in the adjustment.
_VELOCITY_SIGMA = (0.1, 0.2)


@dataclasses.dataclass(frozen=True)
class LensCovariance:
    """Covariance of a lens at a solution, from the residuals.

    Args:
        params: (F, F) covariance of the free parameters, one row a parameter or tied group.
        free: (K,) bool, the parameters that were free.
        basis: (K, F) derivative of all parameters by the free ones.
        with_turn: (F + 3, F + 3) the same, with the turn that best undoes a change of the lens at
            the observations (radians, camera frame).
        noise: standard deviation of a feature's coordinate in pixels.
    """

    params: np.ndarray
    free: np.ndarray
    basis: np.ndarray
    with_turn: np.ndarray
    noise: float

    @property
    def sigmas(self) -> np.ndarray:
        """Standard deviations (K,) of the parameters; 0 if held."""
        return np.sqrt(np.einsum("kf,fg,kg->k", self.basis, self.params, self.basis))

    def estimate_projection_sigma(self, camera: Camera, pixels: np.ndarray) -> np.ndarray:
        """Estimates the standard deviation of distant points' projections in the worst direction.

        A lens that is turned together with all cameras is the same lens: changes count after the
        turn that undoes them best where features were seen.

        Args:
            camera: the refined lens.
            pixels: (N, 2) where the directions are seen.

        Returns:
            (N,) pixels; NaN where the lens has no ray.
        """
        rays, valid = camera.unproject(pixels)
        sigma = np.full(len(pixels), np.nan)
        if not valid.any():
            return sigma
        free = np.flatnonzero(self.basis.any(axis=1))
        by_point, by_params = camera.project_jacobian(rays[valid], free)
        jacobian = np.concatenate(
            [by_params @ self.basis[free], differentiate_by_turn(by_point, rays[valid])], 2
        )
        spread = jacobian @ self.with_turn @ jacobian.transpose(0, 2, 1)
        known = np.isfinite(spread).all(axis=(1, 2))
        values = np.full(len(spread), np.nan)
        values[known] = np.sqrt(np.maximum(np.linalg.eigvalsh(spread[known])[:, -1], 0.0))
        sigma[valid] = values
        return sigma


def estimate_lens_covariances(
    solution: Solution,
    free: LensFlags,
    feature_variance: float = 1.0,
    center_sigma: float = Adjustment.center_sigma,
    turns: StatedTurns | None = None,
) -> list[LensCovariance]:
    """Estimates the covariance of each estimated lens; poses and points are free too.

    The inverse of the normal equations with poses and points eliminated, times a variance that
    takes in what Cauchy's loss costs.

    Args:
        solution: poses and points.
        free: flags of the adjusted parameters, see `Adjustment`.
        feature_variance: FEATURE_VARIANCE for features of photographs, 1 for independent errors.
        center_sigma, turns: see `Adjustment`.

    Raises:
        SolveError: the observations do not determine the lens.
    """
    seen = WeightedObservations(solution, free)
    change = seen.weight * seen.by_lens
    # A body that moves during the readout: as much by its time.
    moves = solution.shutter is not None
    times = solution.measure_line_times()[seen.rows] if moves else None
    prior = _weigh_velocities(solution, seen.median) if moves else np.zeros(6)
    noise = math.sqrt(feature_variance * seen.median / MEDIAN_SQUARE)
    priors = _weigh_centers(seen.lenses.cameras, seen.bases, noise / center_sigma)
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
    noise, variance = seen.estimate_spread(freedom)
    variance *= feature_variance
    turn = seen.weight * differentiate_by_turn(seen.by_p, seen.p)
    found, end = [], 0
    for number, (flags, basis) in enumerate(zip(seen.lenses.free, seen.bases, strict=True)):
        if flags is None or basis is None:
            continue
        place, rows_of = np.arange(end, end + basis.shape[1]), seen.lens_of == number
        end += len(place)
        own_change = change[rows_of][:, :, place].reshape(-1, len(place))
        undone = -np.linalg.lstsq(turn[rows_of].reshape(-1, 3), own_change)[0]
        both = np.concatenate([np.eye(len(place)), undone])
        params = variance * inverse[np.ix_(place, place)]
        turned = both @ params @ both.T
        found.append(LensCovariance(params, np.asarray(flags) > 0, basis, turned, noise))
    return found


def _weigh_velocities(solution: Solution, median: float) -> np.ndarray:
    """Returns (12,) the priors of an image's unknowns; see `_VELOCITY_SIGMA`."""
    size = np.linalg.norm(np.ptp(find_centers(solution.camera_from_world), axis=0))
    sigmas = np.repeat(_VELOCITY_SIGMA, 3) * np.repeat([size, 1.0], 3)
    return np.r_[np.zeros(6), (math.sqrt(median / 2) / sigmas) ** 2]


def _weigh_centers(
    cameras: Sequence[Camera], bases: Sequence[np.ndarray | None], weight: float
) -> np.ndarray:
    """Returns (F,) the priors of free principal points.

    Args:
        weight: of a distance from the middle of the picture over the diagonal.
    """
    priors = []
    for camera, basis in zip(cameras, bases, strict=True):
        if basis is not None:
            is_center = basis[list(CENTER)].sum(axis=0)
            priors.append(is_center * (weight / math.hypot(camera.width, camera.height)) ** 2)
    return np.concatenate(priors)
