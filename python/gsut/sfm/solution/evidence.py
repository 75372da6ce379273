"""Compares solutions by the verified matches that each explains."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from gsut.data.poses import invert_pose
from gsut.judge import (
    MOMENTS,
    TINY,
    Matches,
    Preference,
    Structure,
    measure_angular_errors,
    prefer,
)
from gsut.sfm.matches import PairMatches
from gsut.sfm.photographs import Features
from gsut.sfm.solution.result import Solution, measure_agreement, measure_diagonal


def compare_solutions(
    current: Solution,
    rival: Solution,
    features: Sequence[Features],
    pairs: Sequence[PairMatches],
    more_free: int = 0,
    prior: float = 0.0,
) -> Preference:
    """Compares two solutions of the same images by their matches; see `gsut.judge.prefer`.

    Pairs of images see how their rays meet; points, how more than two images agree. A feature that
    observes a point of one solution alone counts as wrong in the other.

    Args:
        features: of all images.
        pairs: verified matches.
        more_free: parameters that the rival estimates beside those of the current solution.
        prior: logarithm of the rival's prior density over that of the current solution.
    """
    both = [_measure_point_errors(each, features) for each in (current, rival)]
    seen = np.isfinite(both).any(axis=0)
    own = np.repeat(np.arange(len(features)), [len(each) for each in features])[seen]
    images = [np.tile((pair.first, pair.second), (len(pair.matches), 1)) for pair in pairs]
    structures = [
        np.concatenate([measure_match_errors(each, features, pairs), errors[seen]])
        for each, errors in zip((current, rival), both, strict=True)
    ]
    return prefer(
        Structure(structures[0]),
        Structure(structures[1], more_free, prior),
        Matches(
            np.concatenate([*images, np.stack([own, own], axis=1)]),
            measure_diagonal(current.cameras),
        ),
    )


def _measure_point_errors(solution: Solution, features: Sequence[Features]) -> np.ndarray:
    """Measures by how many pixels each image's features miss their points; NaN without one."""
    starts = np.cumsum([0, *(len(each) for each in features)])
    errors = np.full(starts[-1], np.nan)
    _, image, feature = solution.observations.T
    errors[starts[image] + feature] = np.linalg.norm(solution.residuals, axis=1)
    return errors


def measure_match_errors(
    solution: Solution, features: Sequence[Features], pairs: Sequence[PairMatches]
) -> np.ndarray:
    """Measures by how many pixels (M,) the rays of each match miss each other; NaN without a pose.

    Args:
        features: of all images.
        pairs: whose matches count, one after the other.
    """
    rays, by_ray = [], []
    for image, (camera, own) in enumerate(zip(solution.cameras, features, strict=True)):
        seen, valid = camera.unproject(own.pixels)
        seen[~(valid & solution.registered[image])] = np.nan
        rays.append(seen)
        by_ray.append(camera.project_jacobian(seen, with_params=False)[0])
    moments, world_from_camera = _find_moments(solution, features), _list_poses(solution)
    errors = [np.zeros(0)]
    for pair in pairs:
        ends = list(zip((pair.first, pair.second), pair.matches.T, strict=True))
        seen = np.stack([rays[image][column] for image, column in ends])
        poses = np.stack([world_from_camera[i][moments[i][column]] for i, column in ends])
        moves = np.stack([by_ray[image][column] for image, column in ends])
        errors.append(
            measure_angular_errors(seen, poses) * _measure_scales(seen, poses, moves).mean(axis=0)
        )
    return np.concatenate(errors)


def measure_contradiction(
    solution: Solution, features: Sequence[Features], pairs: Sequence[PairMatches], limit: float
) -> tuple[float, np.ndarray]:
    """Measures the share of the pairs whose matches the poses of a solution reject as a whole.

    Hardly any observes a point, and most rays miss each other. Where they meet, other things that
    look alike were matched along the way of the camera, which says nothing of the poses.

    Args:
        features: of all images.
        pairs: verified matches.
        limit: pixels by which rays of right poses miss each other at most.

    Returns:
        It, and the share (N,) of each image's matches that are in such pairs. Where poses are
        wrong, some image loses a third and more; false pairs of right poses have few matches.
    """
    known = [p for p in pairs if solution.registered[p.first] and solution.registered[p.second]]
    ends = np.array([(p.first, p.second) for p in known], np.int64).reshape(-1, 2)
    sizes = np.array([len(p.matches) for p in known], np.int64)
    is_lost = measure_agreement(solution, pairs).rejected
    doubted = np.flatnonzero(is_lost)
    errors = measure_match_errors(solution, features, [known[place] for place in doubted])
    by_pair = np.split(errors, np.cumsum(sizes[doubted]))
    for place, own in zip(doubted, by_pair, strict=False):  # the last part is empty
        is_lost[place] = np.mean(~(own <= limit)) > 0.5
    lost, total = (
        np.bincount(ends.ravel(), np.repeat(counted, 2), len(features))
        for counted in (sizes * is_lost, sizes)
    )
    return float(np.mean(is_lost)) if known else 0.0, lost / np.maximum(total, 1)


def _measure_scales(rays: np.ndarray, poses: np.ndarray, by_ray: np.ndarray) -> np.ndarray:
    """Measures (2, M) pixels a radian across the epipolar planes, where each ray is seen.

    Args:
        rays: (2, M, 3) in camera axes.
        poses: (2, M, 4, 4) world_from_camera.
        by_ray: (2, M, 2, 3) derivatives of the pixels by the rays.
    """
    base = poses[1, :, :3, 3] - poses[0, :, :3, 3]
    in_camera = np.einsum("smji,mj->smi", poses[..., :3, :3], base)
    normal = np.cross(in_camera, rays)
    size = np.linalg.norm(normal, axis=2, keepdims=True)
    across = np.einsum("smij,smj->smi", by_ray, normal / np.maximum(size, TINY))
    anywhere = np.linalg.norm(by_ray, axis=(2, 3)) / np.sqrt(2)
    return np.where(size[..., 0] > TINY, np.linalg.norm(across, axis=2), anywhere)


def _list_poses(solution: Solution) -> np.ndarray:
    """Lists world_from_camera (N, T, 4, 4) of all images, at moments of a readout if rolling."""
    count = 1 if solution.velocities is None else MOMENTS
    times = (np.arange(count) + 0.5) / count
    moments = [solution.interpolate_poses(float(time)) for time in times]
    return np.array([[invert_pose(pose) for pose in poses] for poses in zip(*moments, strict=True)])


def _find_moments(solution: Solution, features: Sequence[Features]) -> list[np.ndarray]:
    """Finds the moment of each image's features in `_list_poses`."""
    lengths = [len(own) for own in features]
    if solution.velocities is None:
        return [np.zeros(length, np.int64) for length in lengths]
    observations = np.zeros((sum(lengths), 3), np.int64)
    observations[:, 1] = np.repeat(np.arange(len(lengths)), lengths)
    every = dataclasses.replace(
        solution,
        observations=observations,
        pixels=np.concatenate([own.pixels for own in features]),
    )
    times = every.measure_line_times() + 0.5
    moments = np.clip((times * MOMENTS).astype(np.int64), 0, MOMENTS - 1)
    return np.split(moments, np.cumsum(lengths)[:-1])
