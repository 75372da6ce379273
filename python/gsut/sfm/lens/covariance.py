"""Estimates how well a lens is known: the covariance of its parameters and projections."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence

import numpy as np

from gsut._core import SolveError
from gsut.data.poses import find_centers
from gsut.lens import Camera
from gsut.sfm.lens.elimination import eliminate_by_windows, eliminate_points
from gsut.sfm.solution import (
    CENTER,
    CENTER_SIGMA,
    LensFlags,
    Solution,
    index_lenses,
)

# Standard deviations of an image's shift, over the extent of the cameras, and of its turn in
# radians during a readout: as in the adjustment.
_VELOCITY_SIGMA = (0.1, 0.2)
_MEDIAN_SQUARE = 2 * math.log(2)  # of a normal vector's length in the plane, in variances
_MOST_POINTS = 6000  # about, that are chosen of more images
_LEAST_SEEN = 30  # chosen points in every image, or all points count
_MOST_IMAGES = 100  # at once; of more the information is added up over windows


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
        by_point, by_params = camera.project_jacobian(rays[valid])
        jacobian = np.concatenate(
            [by_params @ self.basis, differentiate_by_turn(by_point, rays[valid])], 2
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
    loss_scale: float,
    feature_variance: float = 1.0,
    center_sigma: float = CENTER_SIGMA,
) -> list[LensCovariance]:
    """Estimates the covariance of each estimated lens; poses and points are free too.

    The inverse of the normal equations with the points eliminated, times a variance that takes in
    what Cauchy's loss costs (Huber 1964: E[psi^2] / E[psi']^2). The first image and one component
    of the farthest centre are held; the result does not depend on that choice.

    Args:
        solution: poses and points.
        free: flags of the adjusted parameters, see `Adjustment`.
        loss_scale: of Cauchy's loss, in medians of the residuals' lengths, as in the adjustment.
        feature_variance: FEATURE_VARIANCE for features of photographs, 1 for independent errors.
        center_sigma: see `Adjustment`.

    Raises:
        SolveError: the observations do not determine the lens.
    """
    linear = _Linearization(solution, free, loss_scale)
    lenses, bases = linear.lenses, linear.bases
    noise_of_center = math.sqrt(feature_variance * linear.median / _MEDIAN_SQUARE)
    is_large = solution.num_registered > _MOST_IMAGES
    inverse, freedom = (_find_by_windows if is_large else _find_by_all)(
        linear, lambda normal: _add_center_priors(
            normal, lenses.cameras, bases, noise_of_center / center_sigma
        ),
    )  # fmt: skip
    if freedom <= 0 or not np.all(np.diag(inverse) > 0):
        raise SolveError(
            "these images do not determine the lens: give more of them, from different places and "
            "turned in different directions"
        )
    noise, variance = estimate_residual_spread(linear.squared, linear.weight[:, 0, 0] ** 2, freedom)
    variance *= feature_variance
    turn = linear.weight * differentiate_by_turn(linear.by_p, linear.p)
    found, end = [], 0
    for number, (flags, basis) in enumerate(zip(lenses.free, bases, strict=True)):
        if flags is None or basis is None:
            continue
        place, rows_of = np.arange(end, end + basis.shape[1]), linear.lens_of == number
        end += len(place)
        own_change = linear.change[rows_of][:, :, place].reshape(-1, len(place))
        undone = -np.linalg.lstsq(turn[rows_of].reshape(-1, 3), own_change)[0]
        both = np.concatenate([np.eye(len(place)), undone])
        params = variance * inverse[np.ix_(place, place)]
        turned = both @ params @ both.T
        found.append(LensCovariance(params, np.asarray(flags) > 0, basis, turned, noise))
    return found


class _Linearization:
    """Derivatives of the observations, weighted as Cauchy's loss does, and their residuals.

    Attributes:
        lenses, bases: the different lenses, and what turns their free parameters into all.
        image, point, lens_of: (S,) of the observations that have derivatives.
        p: (S, 3) their points in the camera.
        by_p: (S, 2, 3) derivatives by those.
        change: (S, 2, F) weighted derivatives by the free parameters of all lenses.
        squared, median: (S,) squared lengths of the residuals, and their median.
        weight: (S, 1, 1) roots of the weights.
    """

    def __init__(self, solution: Solution, free: LensFlags, loss_scale: float) -> None:
        self.solution = solution
        self.lenses = lenses = index_lenses(solution.cameras, free)
        self.bases = bases = [None if f is None else spread_free_parameters(f) for f in lenses.free]
        image, point = solution.observations[:, 1], solution.observations[:, 0]
        self._poses = poses = solution.camera_from_world
        p = np.einsum("nij,nj->ni", poses[image, :3, :3], solution.points[point])
        p += poses[image, :3, 3]
        lens_of = np.array(lenses.of_image)[image]
        ends = np.cumsum([0 if basis is None else basis.shape[1] for basis in bases])
        by_p, change = np.zeros((len(p), 2, 3)), np.zeros((len(p), 2, ends[-1]))
        for number, (camera, basis, end) in enumerate(
            zip(lenses.cameras, bases, ends, strict=True)
        ):
            own = lens_of == number
            by_p[own], by_params = camera.project_jacobian(p[own])
            if basis is not None:
                change[own, :, end - basis.shape[1] : end] = by_params @ basis
        good = np.isfinite(by_p).all(axis=(1, 2)) & np.isfinite(solution.residuals).all(axis=1)
        self.image, self.point, self.lens_of = image[good], point[good], lens_of[good]
        self.p, self.by_p = p[good], by_p[good]
        self.squared = np.sum(solution.residuals[good] ** 2, axis=1)
        self.median = float(np.median(self.squared))
        scale = loss_scale * max(math.sqrt(self.median), 1e-12)
        self.weight = np.sqrt(1 / (1 + self.squared / scale**2))[:, None, None]
        self.change = self.weight * change[good]
        # A body that moves during the readout: as much by its time.
        moves = solution.shutter is not None
        self._times = solution.measure_line_times()[good] if moves else None
        self.velocity_prior = self._weigh_velocities()

    def differentiate(
        self, chosen: np.ndarray | slice
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Returns weighted derivatives (S, 2, D), (S, 2, F), (S, 2, 3) by poses, lenses, points."""
        weight, by_p = self.weight[chosen], self.by_p[chosen]
        by_centre = -by_p @ self._poses[self.image[chosen], :3, :3]
        rows = weight * np.concatenate(
            [by_centre, differentiate_by_turn(by_p, self.p[chosen])], axis=2
        )
        if self._times is not None:
            rows = np.concatenate([rows, self._times[chosen, None, None] * rows], axis=2)
        return rows, self.change[chosen], -weight * by_centre

    def choose_points(self) -> np.ndarray:
        """Chooses (P,) bool points that determine the lens of many images: every n-th one.

        A share of the observations determines a lens by as much less.
        """
        count = len(self.solution.points)
        chosen = np.arange(count) % max(1, round(count / _MOST_POINTS)) == 0
        seen = np.bincount(self.image[chosen[self.point]], minlength=len(self.solution.names))
        is_enough = seen[self.solution.registered].min() >= _LEAST_SEEN
        return chosen if is_enough else np.ones(count, bool)

    def _weigh_velocities(self) -> np.ndarray:
        """Returns (D,) the priors of an image's unknowns; see `_VELOCITY_SIGMA`."""
        if self._times is None:
            return np.zeros(6)
        size = np.linalg.norm(np.ptp(find_centers(self._poses), axis=0))
        sigmas = np.repeat(_VELOCITY_SIGMA, 3) * np.repeat([size, 1.0], 3)
        return np.r_[np.zeros(6), (math.sqrt(self.median / 2) / sigmas) ** 2]


def _find_by_all(
    linear: _Linearization, add_priors: Callable[[np.ndarray], None]
) -> tuple[np.ndarray, int]:
    """Returns (F, F) the inverse of the lenses' normal equations, and coordinates minus unknowns.

    Args:
        linear: with all observations.
        add_priors: adds what is known beforehand to normal equations that end with the lenses'.
    """
    solution, count = linear.solution, linear.change.shape[2]
    images, unknowns = len(solution.names), len(linear.velocity_prior)
    normal, freedom = eliminate_points(
        linear.image, linear.point, *linear.differentiate(slice(None)), images
    )
    normal[np.diag_indices(images * unknowns)] += np.tile(linear.velocity_prior, images)
    add_priors(normal)
    unknown = _find_unknowns(solution, count, unknowns)
    inverse = _invert(normal[np.ix_(unknown, unknown)])
    return inverse[-count:, -count:], freedom + 2 * len(linear.image) - len(unknown)


def _find_by_windows(
    linear: _Linearization, add_priors: Callable[[np.ndarray], None]
) -> tuple[np.ndarray, int]:
    """Does the same by windows of images, each with poses and points of its own."""
    some = np.flatnonzero(linear.choose_points()[linear.point])
    share = len(some) / len(linear.point)
    normal, freedom = eliminate_by_windows(
        linear.image[some], linear.point[some], find_centers(linear.solution.camera_from_world),
        lambda rows: linear.differentiate(some[rows]), share * linear.velocity_prior,
    )  # fmt: skip
    normal /= share
    add_priors(normal)
    freedom += 2 * len(some) - len(normal)
    return _invert(normal), round(freedom / share)


def _invert(normal: np.ndarray) -> np.ndarray:
    """Inverts normal equations, scaled; NaN where they are singular."""
    size = 1 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
    try:
        return np.linalg.inv(normal * np.outer(size, size)) * np.outer(size, size)
    except np.linalg.LinAlgError:
        return np.full_like(normal, np.nan)


def spread_free_parameters(flags: np.ndarray) -> np.ndarray:
    """Returns (K, F) with a column for each free parameter or tied group of the flags (K,)."""
    flags = np.asarray(flags).astype(int)
    groups = np.where(flags == 1, -1 - np.arange(len(flags)), flags)
    wanted = list(dict.fromkeys(groups[flags > 0].tolist()))
    return np.stack([groups == group for group in wanted], axis=1).astype(np.float64)


def _add_center_priors(
    normal: np.ndarray, cameras: Sequence[Camera], bases: Sequence[np.ndarray | None], weight: float
) -> None:
    """Adds the priors of free principal points to the normal equations, whose last rows are lenses.

    Args:
        weight: of a distance from the middle of the picture over the diagonal.
    """
    place = len(normal) - sum(basis.shape[1] for basis in bases if basis is not None)
    for camera, basis in zip(cameras, bases, strict=True):
        if basis is None:
            continue
        for param in CENTER if weight > 0 else ():
            own = place + np.flatnonzero(basis[param])
            normal[own, own] += (weight / math.hypot(camera.width, camera.height)) ** 2
        place += basis.shape[1]


def estimate_residual_spread(
    squared: np.ndarray, weight: np.ndarray, freedom: int
) -> tuple[float, float]:
    """Estimates a coordinate's noise in pixels, and the factor of the inverse normal equations.

    Args:
        squared: (S,) residuals' squared lengths.
        weight: (S,) of Cauchy's loss, w = 1 / (1 + squared / c^2).
        freedom: number of coordinates minus unknowns.
    """
    lost = 2 * len(squared) / freedom
    noise = math.sqrt(float(np.median(squared)) / _MEDIAN_SQUARE * lost)
    # psi = w r; over all directions of a residual r in the plane its mean derivative is w^2.
    psi = float(np.mean(weight**2 * squared)) / 2
    return noise, lost * psi * float(np.mean(weight)) / float(np.mean(weight**2)) ** 2


def differentiate_by_turn(by_point: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Returns (N, 2, 3) the derivative by w of a function of p + w x p.

    Args:
        by_point: (N, 2, 3) its derivative by the point.
        p: (N, 3) the points.
    """
    return np.cross(p[:, None, :], by_point)


def _find_unknowns(solution: Solution, lens: int, of_image: int) -> np.ndarray:
    """Returns the indices of the unknowns that the gauge leaves free, the lens' last."""
    first, second = solution.initial_pair
    centres = find_centers(solution.camera_from_world)
    axis = int(np.argmax(np.abs(centres[second] - centres[first])))
    keep = np.repeat(solution.registered, of_image)
    keep[of_image * first : of_image * first + 6] = False
    keep[of_image * second + axis] = False
    return np.flatnonzero(np.r_[keep, np.ones(lens, bool)])
