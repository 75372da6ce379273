"""Measures how far poses differ that are adjusted with either half of the points."""

from __future__ import annotations

import dataclasses

import numpy as np

from gsut._core import SolveError
from gsut.sfm.lens import index_points, measure_pose_differences
from gsut.sfm.mapping import Mapping
from gsut.sfm.matches import PairMatches, keep_most_distinct
from gsut.sfm.solution import (
    Adjustment,
    ReadoutMotion,
)

# Images of which structures are found again, or more than one round adds others: each takes all.
MOST_IMAGES = 200
_SHARES = (0.9, 0.6)  # of the pairs of images, that agree where poses are good, and usable
# Images times draws of halves, at least: of few images one draw says little, and costs little.
_IMAGES_DRAWN = 40
# Relative deviation of each half's velocities during a readout from those found.
_VELOCITY_SIGMA = 0.3
# Half of the matches hold an image that all of them hold. A pose found by three points fits these,
# and if it is wrong one or two more of a hundred.
HALF_INLIERS = Adjustment.min_inliers // 2


def compare_halves(mapping: Mapping) -> Mapping:
    """Adds `measure_halves` to the findings, unless the errors of poses are known."""
    if mapping.found.pose_errors_px is not None:
        return mapping
    return mapping.add_findings(pose_errors_px=measure_halves(mapping))


def measure_halves(mapping: Mapping) -> tuple[float, float] | None:
    """Measures half of the difference of poses adjusted with either half of the points.

    It shows what points do not share: wrong matches, and too few of them to hold a pose. An error
    that they share, of the lens, is in both. Velocities during a readout explain much of what poses
    do, so each half finds its own. Few images are dealt several times.

    Returns:
        Pixels that nine and six in ten pairs of images stay below, infinite where halves hold no
        poses; None for a rig, or without points.
    """
    solution = mapping.solved
    if mapping.rig is not None or not len(solution.points):
        return None
    draws = -(-_IMAGES_DRAWN // int(np.count_nonzero(solution.registered)))
    differences = np.concatenate([_draw_differences(mapping, seed) for seed in range(draws)])
    good, usable = 0.5 * np.quantile(differences, _SHARES, method="higher")
    return float(good), float(usable)


def _draw_differences(mapping: Mapping, seed: int) -> np.ndarray:
    """Measures by how many pixels the poses of one draw of halves differ (P,)."""
    solution = mapping.solved
    adjustment = Adjustment(
        lens_settled=True,
        motion=ReadoutMotion.hold(solution, _VELOCITY_SIGMA),
        covariances=False,
        turns=mapping.turns,
        min_inliers=HALF_INLIERS,
    )
    try:
        one, other = (
            mapping.adjust(adjustment, pairs=half) for half in split_matches(mapping, seed)
        )
    except SolveError:
        one = other = dataclasses.replace(solution, registered=np.zeros_like(solution.registered))
    return measure_pose_differences(one, other, solution)


def split_matches(mapping: Mapping, seed: int = 0) -> list[list[PairMatches]]:
    """Splits the matches by the points that they observe, which are dealt to two halves."""
    solution, features = mapping.solved, mapping.features
    rng = np.random.default_rng(seed)
    is_second = rng.random(len(solution.points)) < 0.5
    point_of = index_points(solution, features)
    halves: list[list[PairMatches]] = [[], []]
    for pair in keep_most_distinct(mapping.pairs):
        first, second = pair.matches.T
        point = np.maximum(point_of[pair.first][first], point_of[pair.second][second])
        second_half = np.where(point >= 0, is_second[point], rng.random(len(point)) < 0.5)
        for half, rows in zip(halves, (~second_half, second_half), strict=True):
            matches = pair.matches[rows]
            rotated = pair.rotation_matches * len(matches) // max(1, len(pair.matches))
            half.append(dataclasses.replace(pair, matches=matches, rotation_matches=rotated))
    return halves
