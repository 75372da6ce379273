"""Finds what of a rig the images determine: covariances of its cameras' poses and of the scale."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from gsut.data.poses import find_centers
from gsut.sfm.lens import differentiate_by_turn, eliminate_points, estimate_residual_spread
from gsut.sfm.solution import FEATURE_VARIANCE, RigConstraint, Solution, index_lenses

# Standard deviations beyond which a direction counts as not determined: of a camera's place over
# the size of the rig, which a ruler measures better; and of its turn, which one sees by eye.
_OPEN_SHARE = 0.1
_OPEN_TURN = math.radians(1.0)
# Weak knowledge that keeps the equations regular where images say nothing: of places, over the size
# of rig and path, and of turns in radians.
_ANYWHERE = 100.0


@dataclasses.dataclass(frozen=True)
class MountUncertainty:
    """How well the images determine the pose of a camera on the rig; the rig's size is exact.

    Args:
        place: (3, 3) covariance of its centre in the axes of the rig's first camera, over the
            squared size of the rig.
        turn: (3, 3) covariance of its turn in its own axes, radians.
    """

    place: np.ndarray
    turn: np.ndarray

    def list_open_directions(self) -> list[tuple[str, list[float], float]]:
        """Lists the directions that the images do not determine.

        Returns:
            Of each "place" or "turn", its axis, and the standard deviation: over the rig's size, or
            in radians; infinite where the images say nothing.
        """
        found = []
        for kind, covariance, limit in (
            ("place", self.place, _OPEN_SHARE), ("turn", self.turn, _OPEN_TURN),
        ):  # fmt: skip
            variances, axes = np.linalg.eigh(covariance)
            for variance, axis in zip(variances, axes.T, strict=True):
                sigma = math.sqrt(max(float(variance), 0.0))
                if sigma > limit:
                    axis = axis * np.sign(axis[np.argmax(np.abs(axis))])
                    sigma = sigma if sigma < _ANYWHERE / 10 else math.inf
                    found.append((kind, [float(value) for value in axis], sigma))
        return found


def estimate_mount_uncertainty(
    solution: Solution, constraint: RigConstraint, loss_scale: float
) -> list[MountUncertainty]:
    """Estimates how well the images determine the mounts of a refined rig.

    The inverse of the normal equations with points and poses eliminated; lenses and velocities
    count as known.

    Args:
        solution: with the refined mounts.
        constraint: the frames and mounts of the images.
        loss_scale: of Cauchy's loss, as in the adjustment.
    """
    mounts = solution.camera_from_body
    assert mounts is not None
    used = solution.registered[solution.observations[:, 1]]
    linear = _Linearization(solution, constraint, used, loss_scale)
    bodies = int(constraint.body_of_image.max()) + 1
    normal, freedom = eliminate_points(
        linear.body, linear.point, linear.by_body, linear.by_mounts, linear.by_point, bodies
    )
    size = _measure_size(mounts)
    extent = max(float(np.ptp(find_centers(solution.camera_from_world), axis=0).max()), size)
    units = np.concatenate(
        [np.tile([extent] * 3 + [1.0] * 3, bodies), np.tile([size] * 3 + [1.0] * 3, len(mounts))]
    )
    scaled = normal * np.outer(units, units)
    scaled[np.diag_indices(len(scaled))] += linear.noise**2 / _ANYWHERE**2
    # One body is held, and the size of the rig.
    moving = np.flatnonzero(np.repeat(np.isin(np.arange(bodies), np.unique(linear.body)[1:]), 6))
    rest = _hold_size(mounts, size)
    free = np.zeros((len(scaled), len(moving) + rest.shape[1]))
    free[moving, np.arange(len(moving))] = 1.0
    free[6 * bodies :, len(moving) :] = rest
    variance = linear.estimate_variance(freedom - free.shape[1])
    spread = np.linalg.inv(free.T @ scaled @ free)[len(moving) :, len(moving) :]
    full = variance * rest @ spread @ rest.T
    return [
        MountUncertainty(full[i : i + 3, i : i + 3], full[i + 3 : i + 6, i + 3 : i + 6])
        for i in range(0, len(full), 6)
    ]


class _Linearization:
    """Weighted derivatives of the observations by bodies, mounts and points."""

    def __init__(
        self, solution: Solution, constraint: RigConstraint, used: np.ndarray, loss_scale: float
    ) -> None:
        image = solution.observations[:, 1]
        poses, mounts = solution.camera_from_world, solution.camera_from_body
        assert mounts is not None
        rotation = poses[image, :3, :3]
        world = solution.points[solution.observations[:, 0]]
        p = np.einsum("nij,nj->ni", rotation, world) + poses[image, :3, 3]
        by_p = np.zeros((len(p), 2, 3))
        lenses = index_lenses(solution.cameras, None)
        of_lens = np.array(lenses.of_image)[image]
        for number, camera in enumerate(lenses.cameras):
            own = of_lens == number
            by_p[own], _ = camera.project_jacobian(p[own], with_params=False)
        good = used & np.isfinite(by_p).all(axis=(1, 2))
        good &= np.isfinite(solution.residuals).all(axis=1)
        image, p, by_p, rotation = image[good], p[good], by_p[good], rotation[good]
        self._squared = np.sum(solution.residuals[good] ** 2, axis=1)
        self.noise = max(math.sqrt(float(np.median(self._squared)) / 2), 1e-12)
        scale = loss_scale * max(math.sqrt(float(np.median(self._squared))), 1e-12)
        self._weight = np.sqrt(1 / (1 + self._squared / scale**2))
        weight = self._weight[:, None, None]
        mount = constraint.mount_of_image[image]
        chain = np.stack([np.eye(4), *mounts])[mount + 1]
        turned = chain[:, :3, :3]
        on_body = np.einsum("nji,nj->ni", turned, p - chain[:, :3, 3])
        by_q = by_p @ turned
        self.point = solution.observations[good, 0]
        self.body = constraint.body_of_image[image]
        self.by_point = weight * (by_p @ rotation)
        self.by_body = np.concatenate(
            [-self.by_point, weight * differentiate_by_turn(by_q, on_body)], axis=2
        )
        own = weight * np.concatenate([-by_q, differentiate_by_turn(by_p, p)], axis=2)
        self.by_mounts = np.zeros((len(p), 2, 6 * len(mounts)))
        for number in range(len(mounts)):
            self.by_mounts[mount == number, :, 6 * number : 6 * number + 6] = own[mount == number]

    def estimate_variance(self, freedom: int) -> float:
        """Estimates the factor of the inverse normal equations.

        Args:
            freedom: minus the unknowns.
        """
        left = max(freedom + 2 * len(self._squared), 1)
        factor = estimate_residual_spread(self._squared, self._weight**2, left)[1]
        return FEATURE_VARIANCE * factor


def _measure_size(mounts: np.ndarray) -> float:
    """Returns the root mean square distance of the cameras from their middle."""
    centers = np.concatenate([np.zeros((1, 3)), find_centers(mounts)])
    return float(np.sqrt(((centers - centers.mean(axis=0)) ** 2).sum(axis=1).mean()))


def _hold_size(mounts: np.ndarray, size: float) -> np.ndarray:
    """Returns (6 M, 6 M - 1) changes of the mounts, in the rig's size, that keep that size."""
    centers = np.concatenate([np.zeros((1, 3)), find_centers(mounts)])
    change = np.zeros((len(mounts), 6))
    change[:, :3] = (centers - centers.mean(axis=0))[1:] / size
    along = change.ravel() / np.linalg.norm(change)
    return np.linalg.svd(along[None])[2][1:].T
