"""Measures how far poses differ that are adjusted with either half of the points."""

from __future__ import annotations

import dataclasses
import itertools
import math

import numpy as np

from gsut._core import SolveError
from gsut.data.poses import find_centers
from gsut.gaussians import measure_rotation_angles
from gsut.judge import measure_pixels_per_radian
from gsut.sfm.lens import index_points
from gsut.sfm.mapping import Mapping
from gsut.sfm.matches import PairMatches, keep_most_distinct
from gsut.sfm.solution import (
    MIN_INLIERS,
    Adjustment,
    ReadoutMotion,
    Solution,
    adjust_registered,
    transform_to_cameras,
)

# Images of which structures are found again, or more than one round adds others: each takes all.
MOST_IMAGES = 200
_IMAGES = 100  # that are compared with each other, evenly chosen
_SHARES = (0.9, 0.6)  # of the pairs of images, that agree where poses are good, and usable
# Baseline over the distance of what is seen, below which a pair has no direction to get wrong.
_NO_BASELINE = 0.005
# Images times draws of halves, at least: of few images one draw says little, and costs little.
_IMAGES_DRAWN = 40
# Half of the matches hold an image that all of them hold.
HALF_INLIERS = MIN_INLIERS // 2


def compare_halves(mapping: Mapping) -> Mapping:
    """Adds `measure_halves` to the findings, where they can be measured."""
    halves = measure_halves(mapping)
    return mapping if halves is None else mapping.add_findings(halves_px=halves)


def measure_halves(mapping: Mapping, most_draws: int = _IMAGES_DRAWN) -> tuple[float, float] | None:
    """Measures half of the difference of poses adjusted with either half of the points.

    It shows what points do not share: wrong matches, and too few of them to hold a pose. An error
    that they share, of the lens or the shutter, is in both; the lens, and velocities during a
    readout, are held. Few images are dealt several times, at most `most_draws`.

    Returns:
        Pixels that nine and six in ten pairs of images stay below, infinite where halves hold no
        poses; None for a rig, or without points.
    """
    solution = mapping.solved
    if mapping.rig is not None or not len(solution.points):
        return None
    draws = min(-(-_IMAGES_DRAWN // int(np.count_nonzero(solution.registered))), most_draws)
    differences = np.concatenate([_draw_differences(mapping, seed) for seed in range(draws)])
    good, usable = 0.5 * np.quantile(differences, _SHARES, method="higher")
    return float(good), float(usable)


def _draw_differences(mapping: Mapping, seed: int) -> np.ndarray:
    """Measures by how many pixels the poses of one draw of halves differ (P,)."""
    solution = mapping.solved
    adjustment = Adjustment(
        lens_settled=True,
        motion=ReadoutMotion.hold(solution),
        covariances=False,
        turns=mapping.turns,
        min_inliers=HALF_INLIERS,
    )
    features, options = mapping.features, mapping.options
    try:
        one, other = (
            adjust_registered(solution, features, half, options, adjustment=adjustment)
            for half in split_matches(mapping, seed)
        )
    except SolveError:
        images = min(int(np.count_nonzero(solution.registered)), _IMAGES)
        return np.full(math.comb(images, 2), math.inf)
    return measure_differences(one, other, solution)


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


def measure_differences(one: Solution, other: Solution, solution: Solution) -> np.ndarray:
    """Measures by how many pixels the relative poses of pairs of images differ (P,).

    By the turn between the two images, and by the direction of the baseline as far as it turns what
    is seen. Pairs of which an image has no pose left differ without limit.
    """
    images = np.flatnonzero(solution.registered)
    images = images[np.linspace(0, len(images) - 1, min(len(images), _IMAGES)).astype(int)]
    first, second = np.array(list(itertools.combinations(images, 2))).T
    turns, ways = [], []
    for each in (one, other):
        rotation, centers = each.camera_from_world[:, :3, :3], find_centers(each.camera_from_world)
        turns.append(rotation[second] @ rotation[first].transpose(0, 2, 1))
        ways.append(np.einsum("nij,nj->ni", rotation[second], centers[first] - centers[second]))
    turned = measure_rotation_angles(turns[0] @ turns[1].transpose(0, 2, 1))
    sine = np.linalg.norm(np.cross(*ways), axis=1)
    direction = np.arctan2(sine, np.einsum("ni,ni->n", *ways))
    seen = transform_to_cameras(solution.points, solution.observations, solution.camera_from_world)
    baseline = np.linalg.norm(ways[0], axis=1) / np.median(np.linalg.norm(seen, axis=1))
    direction = np.where(baseline > _NO_BASELINE, np.minimum(baseline, 1.0) * direction, 0.0)
    kept = one.registered & other.registered
    angle = np.where(kept[first] & kept[second], np.maximum(turned, direction), np.inf)
    return angle * measure_pixels_per_radian(solution.cameras[int(images[0])])
