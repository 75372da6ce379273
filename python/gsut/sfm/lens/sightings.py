"""Joins images with points that others see."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gsut.sfm.matches import ENOUGH_MATCHES, FEWEST_MATCHES, RawMatches
from gsut.sfm.photographs import Features
from gsut.sfm.solution import Solution

Sightings = tuple[np.ndarray, np.ndarray]  # pixels (M, 2) and the points (M, 3) seen there


def gather_sightings(
    solution: Solution, features: Sequence[Features], raw: RawMatches
) -> dict[int, Sightings]:
    """Returns, by image, the pixels and the points (M, 3) of others that its matches join."""
    return {
        image: (features[image].pixels[rows[:, 0]], solution.points[rows[:, 1]])
        for image, rows in join_points(solution, features, raw).items()
        if len(rows) >= FEWEST_MATCHES
    }


def join_points(
    solution: Solution, features: Sequence[Features], raw: RawMatches
) -> dict[int, np.ndarray]:
    """Returns, by image, (M, 2) its features and the points of others that its matches join."""
    point_of = index_points(solution, features)
    found: dict[int, list[np.ndarray]] = {}
    for pair, matches in zip(raw.pairs, raw.matches, strict=True):
        for own in (0, 1):
            image, other = int(pair[own]), int(pair[1 - own])
            if not solution.registered[other]:
                continue
            point = point_of[other][matches[:, 1 - own]]
            rows = np.stack([matches[:, own], point], axis=1)[point >= 0]
            found.setdefault(image, []).append(rows[:ENOUGH_MATCHES])
    # One number for a feature and a point: rows of two are sorted far slower.
    count = max(1, len(solution.points))
    joined = {}
    for image, parts in found.items():
        feature, point = np.concatenate(parts).T
        joined[image] = np.stack(np.divmod(np.unique(feature * count + point), count), axis=1)
    return joined


def index_points(solution: Solution, features: Sequence[Features]) -> list[np.ndarray]:
    """Returns the point that each feature of each image observes, -1: none."""
    return solution.index_points(np.array([len(f) for f in features]))
