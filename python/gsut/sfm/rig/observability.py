"""Finds what of a rig the images determine: covariances of its cameras' poses and of the scale."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from gsut import _core
from gsut.data.poses import find_centers
from gsut.sfm.lens import WeightedObservations, differentiate_by_turn
from gsut.sfm.solution import FEATURE_VARIANCE, RigConstraint, Solution

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
    solution: Solution, constraint: RigConstraint
) -> list[MountUncertainty]:
    """Estimates how well the images determine the mounts of a refined rig.

    The inverse of the normal equations with points and poses eliminated; lenses and velocities
    count as known.

    Args:
        solution: with the refined mounts.
        constraint: the frames and mounts of the images.
    """
    mounts = solution.camera_from_body
    assert mounts is not None
    used = solution.registered[solution.observations[:, 1]]
    seen = WeightedObservations(solution, used=used)
    size = _measure_size(mounts)
    extent = max(float(np.ptp(find_centers(solution.camera_from_world), axis=0).max()), size)
    noise = max(math.sqrt(seen.median / 2), 1e-12)
    anywhere = noise**2 / _ANYWHERE**2
    by_body, by_mounts, by_point = _differentiate(seen, solution, constraint)
    # One body is held, and the size of the rig.
    normal, determined = _core.shared_information(
        np.unique(constraint.body_of_image[seen.image], return_inverse=True)[1],
        np.unique(seen.point, return_inverse=True)[1], by_body, by_mounts, by_point,
        anywhere / np.repeat([extent**2, 1.0], 3), list(range(6)),
    )  # fmt: skip
    units = np.tile([size] * 3 + [1.0] * 3, len(mounts))
    scaled = normal * np.outer(units, units)
    scaled[np.diag_indices(len(scaled))] += anywhere
    rest = _hold_size(mounts, size)
    freedom = max(2 * len(seen.rows) - determined - rest.shape[1], 1)
    variance = FEATURE_VARIANCE * seen.estimate_spread(freedom)
    full = variance * rest @ np.linalg.inv(rest.T @ scaled @ rest) @ rest.T
    return [
        MountUncertainty(full[i : i + 3, i : i + 3], full[i + 3 : i + 6, i + 3 : i + 6])
        for i in range(0, len(full), 6)
    ]


def _differentiate(
    seen: WeightedObservations, solution: Solution, constraint: RigConstraint
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns weighted derivatives (O, 2, 6), (O, 2, 6 M), (O, 2, 3) by bodies, mounts, points."""
    mounts = solution.camera_from_body
    assert mounts is not None
    mount = constraint.mount_of_image[seen.image]
    chain = np.stack([np.eye(4), *mounts])[mount + 1]
    on_body = np.einsum("nji,nj->ni", chain[:, :3, :3], seen.p - chain[:, :3, 3])
    by_p = seen.weight * seen.by_p
    by_q = by_p @ chain[:, :3, :3]
    by_point = by_p @ solution.camera_from_world[seen.image, :3, :3]
    by_body = np.concatenate([-by_point, differentiate_by_turn(by_q, on_body)], axis=2)
    own = np.concatenate([-by_q, differentiate_by_turn(by_p, seen.p)], axis=2)
    by_mounts = np.zeros((len(own), 2, 6 * len(mounts)))
    for number in range(len(mounts)):
        by_mounts[mount == number, :, 6 * number : 6 * number + 6] = own[mount == number]
    return by_body, by_mounts, by_point


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
