"""Estimates how well a lens is known: the covariance of its parameters and projections."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from gsut._core import SolveError
from gsut.data.poses import find_centers
from gsut.lens import Camera
from gsut.sfm.solution import CENTER, CENTER_SIGMA, LensFlags, Solution, index_lenses

# Standard deviations of an image's shift, over the extent of the cameras, and of its turn in
# radians during a readout: as in the adjustment.
_VELOCITY_SIGMA = (0.1, 0.2)
_MEDIAN_SQUARE = 2 * math.log(2)  # of a normal vector's length in the plane, in variances
# A direction of a point whose square counts less than this share is open: parallax below 1e-6 rad.
_OPEN = 1e-12
_CHUNK = 2000  # points whose pairs of observations are summed at once, to bound memory
_MANY_IMAGES = 100  # beyond which a part of the points is enough
_MOST_POINTS = 4000  # chosen of many images
_LEAST_SEEN = 30  # chosen points in every image, or all points count


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
    lenses = index_lenses(solution.cameras, free)
    bases = [None if flags is None else spread_free_parameters(flags) for flags in lenses.free]
    ends = np.cumsum([0 if basis is None else basis.shape[1] for basis in bases])
    image, point = solution.observations[:, 1], solution.observations[:, 0]
    poses = solution.camera_from_world
    rotation = poses[image, :3, :3]
    p = np.einsum("nij,nj->ni", rotation, solution.points[point]) + poses[image, :3, 3]
    lens_of = np.array(lenses.of_image)[image]
    by_p, change = np.zeros((len(p), 2, 3)), np.zeros((len(p), 2, ends[-1]))
    for number, (camera, basis, end) in enumerate(zip(lenses.cameras, bases, ends, strict=True)):
        own = lens_of == number
        by_p[own], by_params = camera.project_jacobian(p[own])
        if basis is not None:
            change[own, :, end - basis.shape[1] : end] = by_params @ basis
    good = np.isfinite(by_p).all(axis=(1, 2)) & np.isfinite(solution.residuals).all(axis=1)
    some = _choose_points(solution)[point]
    share = np.count_nonzero(good & some) / np.count_nonzero(good)
    good &= some
    image, point, rotation, p = image[good], point[good], rotation[good], p[good]
    by_p, change, lens_of = by_p[good], change[good], lens_of[good]
    residual = solution.residuals[good]
    squared = np.sum(residual**2, axis=1)
    scale = loss_scale * max(math.sqrt(float(np.median(squared))), 1e-12)
    weight = np.sqrt(1 / (1 + squared / scale**2))[:, None, None]
    by_centre = -by_p @ rotation
    change = weight * change
    rows = weight * np.concatenate([by_centre, differentiate_by_turn(by_p, p)], axis=2)
    if solution.shutter is not None:  # a body that moves during the readout: as much by its time
        rows = np.concatenate(
            [rows, solution.measure_line_times()[good, None, None] * rows], axis=2
        )
    normal, freedom = eliminate_points(image, point, rows, change, -weight * by_centre, len(poses))
    deviation = math.sqrt(share * float(np.median(squared)) / 2)
    _add_velocity_priors(normal, solution, deviation, rows.shape[2])
    weight_of_center = math.sqrt(
        share * feature_variance * float(np.median(squared)) / _MEDIAN_SQUARE
    )
    _add_center_priors(normal, lenses.cameras, bases, weight_of_center / center_sigma)
    freedom += 2 * len(image)
    unknown = _find_unknowns(solution, change.shape[2], rows.shape[2])
    freedom -= len(unknown)
    small = normal[np.ix_(unknown, unknown)]
    size = 1 / np.sqrt(np.maximum(np.diag(small), 1e-300))
    try:
        inverse = np.linalg.inv(small * np.outer(size, size)) * np.outer(size, size)
    except np.linalg.LinAlgError:
        inverse = np.full_like(small, np.nan)
    lens = np.arange(len(small) - change.shape[2], len(small))
    if freedom <= 0 or not np.all(np.diag(inverse)[lens] > 0):
        raise SolveError(
            "these images do not determine the lens: give more of them, from different places and "
            "turned in different directions"
        )
    noise, variance = estimate_residual_spread(squared, weight[:, 0, 0] ** 2, freedom)
    variance *= feature_variance * share
    turn = weight * differentiate_by_turn(by_p, p)
    found = []
    for number, (flags, basis, end) in enumerate(zip(lenses.free, bases, ends, strict=True)):
        if flags is None or basis is None:
            continue
        size, rows_of = basis.shape[1], lens_of == number
        own_change = change[rows_of][:, :, end - size : end].reshape(-1, size)
        undone = -np.linalg.lstsq(turn[rows_of].reshape(-1, 3), own_change)[0]
        both = np.concatenate([np.eye(size), undone])
        place = lens[end - size : end]
        params = variance * inverse[np.ix_(place, place)]
        turned = both @ params @ both.T
        found.append(LensCovariance(params, np.asarray(flags) > 0, basis, turned, noise))
    return found


def _choose_points(solution: Solution) -> np.ndarray:
    """Chooses (P,) bool points that determine a lens: every n-th one where images are many.

    A share of the observations determines a lens by as much less.
    """
    count = len(solution.points)
    step = -(-count // _MOST_POINTS)
    chosen = np.arange(count) % step == 0 if count else np.ones(0, bool)
    point, image = solution.observations[:, 0], solution.observations[:, 1]
    seen = np.bincount(image[chosen[point]], minlength=len(solution.names))
    is_enough = seen[solution.registered].min() >= _LEAST_SEEN
    if solution.num_registered <= _MANY_IMAGES or not is_enough:
        return np.ones(count, bool)
    return chosen


def spread_free_parameters(flags: np.ndarray) -> np.ndarray:
    """Returns (K, F) with a column for each free parameter or tied group of the flags (K,)."""
    flags = np.asarray(flags).astype(int)
    groups = np.where(flags == 1, -1 - np.arange(len(flags)), flags)
    wanted = list(dict.fromkeys(groups[flags > 0].tolist()))
    return np.stack([groups == group for group in wanted], axis=1).astype(np.float64)


def _add_velocity_priors(
    normal: np.ndarray, solution: Solution, noise: float, unknowns: int
) -> None:
    """Adds the priors of velocities to the normal equations; see `_VELOCITY_SIGMA`."""
    if unknowns == 6:
        return
    size = np.linalg.norm(np.ptp(find_centers(solution.camera_from_world), axis=0))
    for image in range(len(solution.names)):
        for k in range(6):
            sigma = _VELOCITY_SIGMA[k // 3] * (size if k < 3 else 1.0)
            place = unknowns * image + 6 + k
            normal[place, place] += (noise / sigma) ** 2


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


def eliminate_points(
    image: np.ndarray,
    point: np.ndarray,
    by_pose: np.ndarray,
    by_lens: np.ndarray,
    by_point: np.ndarray,
    images: int,
) -> tuple[np.ndarray, int]:
    """Eliminates the points from the normal equations (D images + F, same): Schur complement.

    Args:
        image, point: (S,) of the observations.
        by_pose: (S, 2, D), by_lens: (S, 2, F), by_point: (S, 2, 3) weighted derivatives.
        images: number of images.

    Returns:
        The matrix, and minus one for each direction in which a point is determined: what the points
        add to the freedom. Images of one place leave the distance of a point open.
    """
    order = np.argsort(point, kind="stable")
    image, point = image[order], point[order]
    by_pose, by_lens, by_point = by_pose[order], by_lens[order], by_point[order]
    count = by_lens.shape[2]
    unknowns = by_pose.shape[2]
    own = np.zeros((images, images, unknowns, unknowns))
    with_lens = np.zeros((images, unknowns, count))
    lens = np.einsum("nri,nrj->ij", by_lens, by_lens)
    np.add.at(own, (image, image), by_pose.transpose(0, 2, 1) @ by_pose)
    np.add.at(with_lens, image, by_pose.transpose(0, 2, 1) @ by_lens)
    starts = np.flatnonzero(np.r_[True, point[1:] != point[:-1]])
    lengths = np.diff(np.r_[starts, len(point)])
    determined = 0
    for length in np.unique(lengths):
        chosen = starts[lengths == length]
        for begin in range(0, len(chosen), _CHUNK):
            rows = chosen[begin : begin + _CHUNK, None] + np.arange(length)
            c = by_point[rows]  # (points, observations, 2, 3)
            pose_c = by_pose[rows].transpose(0, 1, 3, 2) @ c  # (points, observations, D, 3)
            lens_c = (by_lens[rows].transpose(0, 1, 3, 2) @ c).sum(axis=1)  # (points, F, 3)
            inverse, ranks = _invert_normals((c.transpose(0, 1, 3, 2) @ c).sum(axis=1))
            determined += ranks
            pose_i = pose_c @ inverse[:, None]
            at = image[rows]
            np.subtract.at(
                own,
                (at[:, :, None], at[:, None, :]),
                np.einsum("nsij,ntkj->nstik", pose_i, pose_c, optimize=True),
            )
            np.subtract.at(with_lens, at, pose_i @ lens_c.transpose(0, 2, 1)[:, None])
            lens -= np.einsum("nij,nkj->ik", lens_c @ inverse, lens_c)
    size = unknowns * images
    cross = with_lens.reshape(size, count)
    poses = own.transpose(0, 2, 1, 3).reshape(size, size)
    return np.block([[poses, cross], [cross.T, lens]]), -determined


def _invert_normals(normals: np.ndarray) -> tuple[np.ndarray, int]:
    """Inverts symmetric matrices (N, 3, 3) where they are determined; elsewhere the inverse is 0.

    Returns:
        The inverses, and the sum of their ranks.
    """
    scale = np.trace(normals, axis1=1, axis2=2) / 3
    is_open = ~(np.linalg.det(normals) > _OPEN * scale**3)
    inverse = np.empty_like(normals)
    inverse[~is_open] = np.linalg.inv(normals[~is_open])
    values, axes = np.linalg.eigh(normals[is_open])
    known = values > _OPEN * values[:, -1:]
    values = np.where(known, 1 / np.where(known, values, 1), 0)
    inverse[is_open] = (axes * values[:, None, :]) @ axes.transpose(0, 2, 1)
    return inverse, int(3 * np.count_nonzero(~is_open) + np.count_nonzero(known))


def _find_unknowns(solution: Solution, lens: int, of_image: int) -> np.ndarray:
    """Returns the indices of the unknowns that the gauge leaves free, the lens' last."""
    first, second = solution.initial_pair
    centres = find_centers(solution.camera_from_world)
    axis = int(np.argmax(np.abs(centres[second] - centres[first])))
    keep = np.repeat(solution.registered, of_image)
    keep[of_image * first : of_image * first + 6] = False
    keep[of_image * second + axis] = False
    return np.flatnonzero(np.r_[keep, np.ones(lens, bool)])
