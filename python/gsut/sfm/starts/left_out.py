"""Registers images that no pair of verified matches connects, by all points their matches join."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from gsut import _core
from gsut._core import SolveError
from gsut.data import list_some
from gsut.data.poses import invert_pose
from gsut.judge import TINY
from gsut.sampling import MAJORITY
from gsut.sfm.lens import ROUGH, join_points
from gsut.sfm.mapping import Mapping
from gsut.sfm.matches import PairMatches
from gsut.sfm.solution import Adjustment, ReadoutMotion, Solution, measure_match_errors
from gsut.sfm.starts.halves import HALF_INLIERS, MOST_IMAGES

# Share of the joined points that a pose must fit: chance fits one in thousands.
_FITS = 0.2


def register_left_out(mapping: Mapping) -> Mapping:
    """Registers images whose matches with many images are too few pair by pair, but not together.

    A photograph far from the others shares few features with each of them. Its pose is that which
    most of the points fit that its matches join, however few, and predicts where its features meet
    those of other images. Then everything is adjusted again, and the image is kept if it observes
    enough points that do not depend on it. It may join others, so this is repeated while there are
    any. Does nothing for a rig, or where those left form models of their own.

    Returns:
        The run with solution and pairs.
    """
    if mapping.rig is not None or mapping.found.models:
        return mapping
    before = set(mapping.solved.unregistered_names)
    while not mapping.solved.registered.all() and len(mapping.solved.points):
        poses = _find_poses(mapping)
        best = [each for each in poses if each[0] >= MAJORITY * poses[0][0]]
        more = _add_images(mapping, best)
        if more is None and len(best) < len(poses):
            more = _add_images(mapping, poses)
        mapping = more or mapping
        if more is None or len(mapping.solved.names) > MOST_IMAGES:
            break
    added = sorted(before - set(mapping.solved.unregistered_names))
    if added:
        mapping.log.note(
            "poses are less certain of images that share few points with the others: "
            f"{list_some(added)}"
        )
    return mapping


def _find_poses(mapping: Mapping) -> list[tuple[int, int, np.ndarray]]:
    """Finds poses of images without one: points that fit, image, (4, 4); most points first."""
    solution, options = mapping.solved, mapping.options
    found = []
    for image, rows in join_points(solution, mapping.features, mapping.raw).items():
        if solution.registered[image]:
            continue
        lens = solution.cameras[image]
        bearings = _core.ImageBearings(lens, mapping.features[image].pixels[rows[:, 0]])
        good = np.flatnonzero(bearings.valid)
        if len(good) < HALF_INLIERS:
            continue
        points = solution.points[rows[good, 1]]
        limit = _limit_error(mapping, image)
        pose, fits = _core.absolute_pose(bearings, good, points, limit, options.seed)
        count = len(np.unique(rows[good[fits], 1]))
        if count >= max(HALF_INLIERS, _FITS * len(rows)):
            found.append((count, image, pose))
    return sorted(found, key=lambda each: -each[0])


def _limit_error(mapping: Mapping, image: int) -> float:
    """Returns the largest error of an image's points while its pose is sought, in pixels."""
    lens = mapping.solved.cameras[image]
    return ROUGH * mapping.options.max_error * math.hypot(lens.width, lens.height) / 1000


def _add_images(mapping: Mapping, found: list[tuple[int, int, np.ndarray]]) -> Mapping | None:
    """Adds images to the solution, without those that it does not hold; None if none is left."""
    solution, poses = mapping.solved, {image: pose for _, image, pose in found}
    while poses:
        start = dataclasses.replace(
            solution,
            camera_from_world=solution.camera_from_world.copy(),
            registered=solution.registered.copy(),
            shutter=None,
            velocities=None,
        )
        for image, pose in poses.items():
            start.camera_from_world[image], start.registered[image] = pose, True
        pairs = [*mapping.pairs, *_match_images(mapping, start, set(poses))]
        adjustment = Adjustment(
            mapping.lens_free, motion=ReadoutMotion.follow(solution), extend=True,
            turns=mapping.turns, min_inliers=HALF_INLIERS,
        )  # fmt: skip
        try:
            more = mapping.adjust(adjustment, start, pairs, "mapping")
        except SolveError:  # the image that holds the scale is one of those that do not fit
            poses = dict(list(poses.items())[: len(poses) // 2])
            continue
        held = _count_held(more, solution.registered)
        kept = {image: pose for image, pose in poses.items() if held[image] >= HALF_INLIERS}
        if len(kept) == len(poses):
            if not np.all(more.registered[start.registered]):
                return None
            return mapping.replace(solution=more, pairs=pairs)
        poses = kept
    return None


def _count_held(solution: Solution, others: np.ndarray) -> np.ndarray:
    """Counts (N,) the points each image observes that two of the others (N,) bool observe too."""
    point, image = solution.observations[:, 0], solution.observations[:, 1]
    counts = np.bincount(point[others[image]], minlength=len(solution.points))
    return np.bincount(image[counts[point] >= 2], minlength=len(solution.names))


def _match_images(mapping: Mapping, start: Solution, images: set[int]) -> list[PairMatches]:
    """Returns the matches that meet, of pairs with such an image that were not verified."""
    verified = {(pair.first, pair.second) for pair in mapping.pairs}
    predicted = []
    for pair, matches in zip(mapping.raw.pairs, mapping.raw.matches, strict=True):
        first, second = (int(image) for image in pair)
        is_open = (first in images or second in images) and (first, second) not in verified
        if is_open and start.registered[first] and start.registered[second]:
            relative = start.camera_from_world[second] @ invert_pose(start.camera_from_world[first])
            relative[:3, 3] /= max(float(np.linalg.norm(relative[:3, 3])), TINY)
            predicted.append(PairMatches(first, second, matches, relative, 0, 0.0, True))
    errors = measure_match_errors(start, mapping.features, predicted)
    ends = np.cumsum([len(pair.matches) for pair in predicted])
    found = []
    for pair, own in zip(predicted, np.split(errors, ends), strict=False):  # the last part is empty
        matches = pair.matches[own < _limit_error(mapping, pair.first)]
        if len(matches):
            pair = dataclasses.replace(pair, matches=matches)
            found.append(
                dataclasses.replace(pair, parallax=_measure_parallax(mapping, start, pair))
            )
    return found


def _measure_parallax(mapping: Mapping, start: Solution, pair: PairMatches) -> float:
    """Measures the parallax of a pair of images whose poses are known, see `PairMatches`."""
    one, other = (
        start.cameras[image].unproject(mapping.features[image].pixels[column])[0]
        @ start.camera_from_world[image, :3, :3]
        for image, column in zip((pair.first, pair.second), pair.matches.T, strict=True)
    )
    sine = np.linalg.norm(np.cross(one, other), axis=1)
    return float(np.percentile(np.arctan2(sine, np.sum(one * other, axis=1)), 75))
