"""Compares two sets of camera poses: how each moved, and how all of them moved together."""

from __future__ import annotations

import dataclasses

import numpy as np

from gsut._core import exp_pose
from gsut.data.poses import find_centers
from gsut.gaussians import find_rotation_vectors

# Spread of camera centres relative to their size: below it they determine no scale.
_SMALLEST_SPREAD = 1e-12


@dataclasses.dataclass(frozen=True)
class PoseChanges:
    """How far each of N poses turned and moved.

    Attributes:
        degrees: (N,) angles of rotation.
        distances: (N,) of the centres, world units.
    """

    degrees: np.ndarray
    distances: np.ndarray


def measure_pose_changes(after: np.ndarray, before: np.ndarray) -> PoseChanges:
    """Measures angles and distances between two sets of poses (N, 4, 4), camera_from_world."""
    turns = np.linalg.norm(_compute_turns(after, before), axis=1)
    return PoseChanges(
        np.degrees(turns), np.linalg.norm(find_centers(after) - find_centers(before), axis=1)
    )


def remove_mean_motion(after: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Removes from `after` the small similarity that best carries `before` into it.

    This takes out the mean rotation, translation and scale, so that a scene that fits `before` fits
    the result too. Exact to first order.

    Args:
        after, before: (N, 4, 4) camera_from_world.
    """
    turn = _rotation_from_vector(_compute_turns(after, before).mean(axis=0))
    start, end = find_centers(before), find_centers(after)
    spread = start - start.mean(axis=0)
    turned = (end - end.mean(axis=0)) @ turn  # by the inverse of the mean turn
    size = float(np.sum(spread**2))
    growth = 1.0
    if size > _SMALLEST_SPREAD * max(1.0, float(np.sum(start**2))):
        growth = float(np.sum(spread * turned)) / size
    centers = turned / (growth if growth > 0 else 1.0) + start.mean(axis=0)
    return _poses_from_rotations(after[:, :3, :3] @ turn, centers)


def turn_onto(after: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Moves the world of `after` by the small rotation and translation that fit `before` best.

    Centres alone do not determine a rotation about a path that is nearly a line, so the rotations
    of the cameras count too; both are weighted by their scatter. For rotations of a few degrees.

    Args:
        after, before: (N, 4, 4) camera_from_world.
    """
    turns, start = _compute_turns(after, before), find_centers(before)
    spread = find_centers(after) - find_centers(after).mean(axis=0)
    missing = start - start.mean(axis=0) - spread
    of_turns = float(np.median(np.sum((turns - turns.mean(axis=0)) ** 2, axis=1)))
    of_centers = float(np.median(np.sum(missing**2, axis=1)))
    # Least squares of turns + w over its variance and of w x spread - missing over the other.
    size = float(np.sum(spread**2))
    trust = max(of_turns, _SMALLEST_SPREAD)
    balance = max(of_centers, _SMALLEST_SPREAD * size) / trust
    normal = (balance * len(turns) + size) * np.eye(3) - spread.T @ spread
    right = np.cross(spread, missing).sum(axis=0) - balance * turns.sum(axis=0)
    turn = _rotation_from_vector(np.linalg.solve(normal, right))
    return _poses_from_rotations(after[:, :3, :3] @ turn.T, spread @ turn.T + start.mean(axis=0))


def extrapolate(after: np.ndarray, before: np.ndarray, factor: float | np.ndarray) -> np.ndarray:
    """Returns poses that are `factor` (one, or (N,)) times as far from `before` as `after` is."""
    factors = np.reshape(factor, (-1, 1))
    turns = factors * _compute_turns(after, before)
    centers = find_centers(before) + factors * (find_centers(after) - find_centers(before))
    rotations = [
        old[:3, :3] @ _rotation_from_vector(w).T for old, w in zip(before, turns, strict=True)
    ]
    return _poses_from_rotations(np.array(rotations), centers)


def _rotation_from_vector(vector: np.ndarray) -> np.ndarray:
    return exp_pose(np.concatenate([np.zeros(3), vector]))[:3, :3]


def _poses_from_rotations(rotations: np.ndarray, centers: np.ndarray) -> np.ndarray:
    """Makes camera_from_world (N, 4, 4) from its rotations (N, 3, 3) and centres (N, 3)."""
    out = np.tile(np.eye(4), (len(centers), 1, 1))
    out[:, :3, :3] = rotations
    out[:, :3, 3] = -np.einsum("nij,nj->ni", out[:, :3, :3], centers)
    return out


def _compute_turns(after: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Computes (N, 3) rotation vectors, world axes, from axes of `before` to those of `after`."""
    relative = np.einsum("nji,njk->nik", after[:, :3, :3], before[:, :3, :3])
    return find_rotation_vectors(relative)
