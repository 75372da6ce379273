"""Joins models of cameras that see nothing in common, by the rig that carries them."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from gsut.data.poses import find_centers
from gsut.data.rigs import Rig
from gsut.gaussians import measure_rotation_angles
from gsut.sfm.mapping import Mapping
from gsut.sfm.photographs import Photographs
from gsut.sfm.solution import Solution, solve_left_out

_FEWEST = 4  # images of the other model with a mate in the first
_AGREE = np.radians(5.0)  # of turns between the models, from frame to frame
# Relative standard deviations of the models' scales up to which they are joined: where the rig
# hardly turns, its baselines set none.
_KNOWN = 0.2


def join_models_of_cameras(mapping: Mapping, rig: Rig) -> Solution:
    """Joins models of images of the same frames that share no points with the solution.

    Cameras that never see the same things make models of their own, each with a world and a scale.
    Where the rig turns, its baselines determine both (as hand and eye do each other).

    Returns:
        The solution with them.
    """
    solution, frames = mapping.solved, mapping.photographs.frames
    assert frames is not None
    left = ~solution.registered & np.isin(frames, frames[solution.registered])
    images = dataclasses.replace(mapping.images, cameras=solution.cameras, lines=solution.lines)
    for other, _ in solve_left_out(images, left, mapping.pairs, mapping.options):
        found = _find_similarity(mapping.photographs, rig, solution, other)
        if found is not None:
            solution = _merge(solution, other, *found)
    return solution


def _find_similarity(
    photographs: Photographs, rig: Rig, first: Solution, other: Solution
) -> tuple[float, np.ndarray, np.ndarray] | None:
    """Finds scale, rotation and translation from the other model's world to the first one's.

    None where too few frames have images of both, or these do not determine it.
    """
    frames, cameras = photographs.frames, photographs.rig_cameras
    assert frames is not None and cameras is not None
    seats = find_centers(rig.camera_from_reference)
    centers = find_centers(first.camera_from_world), find_centers(other.camera_from_world)
    pairs = [
        (i, j)
        for j in np.flatnonzero(other.registered)
        for i in np.flatnonzero(first.registered & (frames == frames[j]))
    ]
    if len(pairs) < _FEWEST:
        return None
    mine, its = np.array(pairs).T
    # World -> the rig's reference, by each image.
    back = rig.camera_from_reference[cameras, :3, :3].transpose(0, 2, 1)
    turns = back[mine] @ first.camera_from_world[mine, :3, :3]
    turned = turns.transpose(0, 2, 1) @ back[its] @ other.camera_from_world[its, :3, :3]
    u, _, v = np.linalg.svd(turned.sum(axis=0))
    rotation = u @ v
    if np.linalg.det(rotation) < 0 or (
        np.median(measure_rotation_angles(turned @ rotation.T)) > _AGREE
    ):
        return None
    # centre = scale R other's centre + unit R_frame^T (seat - other's seat) + translation
    levers = np.einsum("nji,nj->ni", turns, seats[cameras[mine]] - seats[cameras[its]])
    columns = np.zeros((len(pairs), 3, 5))
    columns[:, :, 0], columns[:, :, 1] = centers[1][its] @ rotation.T, levers
    columns[:, :, 2:] = np.eye(3)
    matrix, target = columns.reshape(-1, 5), centers[0][mine].ravel()
    values, _, rank, _ = np.linalg.lstsq(matrix, target, rcond=None)
    scale, unit = values[:2]
    if rank < 5 or not (scale > 0 and unit > 0):
        return None
    variance = np.sum((matrix @ values - target) ** 2) / max(len(target) - 5, 1)
    sigmas = np.sqrt(variance * np.diag(np.linalg.inv(matrix.T @ matrix))[:2])
    if not (sigmas < _KNOWN * values[:2]).all():
        return None
    return float(scale), rotation, values[2:]


def _merge(
    first: Solution, other: Solution, scale: float, rotation: np.ndarray, translation: np.ndarray
) -> Solution:
    """Merges another model into a solution, in its world."""
    poses, chosen = first.camera_from_world.copy(), other.registered & ~first.registered
    centers = scale * find_centers(other.camera_from_world) @ rotation.T + translation
    poses[chosen, :3, :3] = other.camera_from_world[chosen, :3, :3] @ rotation.T
    poses[chosen, :3, 3] = -np.einsum("nij,nj->ni", poses[chosen, :3, :3], centers[chosen])
    velocities = first.velocities
    if velocities is not None and other.velocities is not None:
        velocities = velocities.copy()
        velocities[chosen, :3] = scale * other.velocities[chosen, :3] @ rotation.T
        velocities[chosen, 3:] = other.velocities[chosen, 3:]
    moved = other.observations.copy()
    moved[:, 0] += len(first.points)
    both: dict[str, Any] = {
        name: np.concatenate([getattr(first, name), getattr(other, name)])
        for name in ("colors", "point_errors", "pixels", "residuals", "field_angles")
    }
    return dataclasses.replace(
        first,
        registered=first.registered | chosen,
        camera_from_world=poses,
        velocities=velocities,
        points=np.concatenate([first.points, scale * other.points @ rotation.T + translation]),
        observations=np.concatenate([first.observations, moved]),
        **both,
    )
