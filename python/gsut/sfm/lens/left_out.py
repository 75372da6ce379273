"""Registers images that no pair of verified matches connects, by all points their matches join."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from gsut import _core
from gsut._core import SolveError
from gsut.data.poses import find_centers, invert_pose
from gsut.sfm.lens.zooms import index_points, join_points
from gsut.sfm.mapping import Mapping
from gsut.sfm.matches import PairMatches
from gsut.sfm.solution import Adjustment, adjust_registered

# Share of the joined points that a pose must fit: chance fits one in thousands.
_FITS = 0.2


def register_left_out(mapping: Mapping) -> None:
    """Registers images whose matches with many images are too few pair by pair, but not together.

    A photograph far from the others shares few features with each of them. Its pose is that which
    most of the points fit that its matches join; then everything is adjusted again. Does nothing
    with a rolling shutter, or where images were taken at several zooms.

    Sets the mapping's solution and pairs.
    """
    solution, options = mapping.solved, mapping.options
    if solution.shutter is not None or mapping.found.zooms or solution.registered.all():
        return
    poses, registered = solution.camera_from_world.copy(), solution.registered.copy()
    pairs = []
    for image, rows in join_points(solution, mapping.features, mapping.raw).items():
        lens = solution.cameras[image]
        bearings = _core.ImageBearings(lens, mapping.features[image].pixels[rows[:, 0]])
        good = np.flatnonzero(bearings.valid)
        if solution.registered[image] or len(good) < options.min_inliers:
            continue
        points = solution.points[rows[good, 1]]
        max_error = options.max_error * math.hypot(lens.width, lens.height) / 1000
        pose, fits = _core.absolute_pose(bearings, good, points, max_error, options.seed)
        fitting = rows[good[fits]]
        if len(np.unique(fitting[:, 1])) < max(options.min_inliers, _FITS * len(rows)):
            continue
        poses[image], registered[image] = pose, True
        pairs += _join_pairs(mapping, image, pose, fitting)
    if not pairs:
        return
    start = dataclasses.replace(solution, camera_from_world=poses, registered=registered)
    adjustment = Adjustment(mapping.lens_free, extend=True)
    on_step = mapping.log.follow_steps("mapping")
    try:
        more = adjust_registered(
            start, mapping.features, [*mapping.pairs, *pairs], options, on_step, adjustment
        )
    except SolveError:
        return
    if more.num_registered > solution.num_registered:
        mapping.solution, mapping.pairs = more, [*mapping.pairs, *pairs]


def _join_pairs(
    mapping: Mapping, image: int, pose: np.ndarray, fitting: np.ndarray
) -> list[PairMatches]:
    """Returns the matches of an image with others at the points that its pose fits."""
    solution, raw = mapping.solved, mapping.raw
    point_of = index_points(solution, mapping.features)
    own_point = np.full(len(mapping.features[image]), -2)
    own_point[fitting[:, 0]] = fitting[:, 1]
    found = []
    for pair, matches in zip(raw.pairs, raw.matches, strict=True):
        if image not in pair:
            continue
        own = int(pair[1] == image)
        other = int(pair[1 - own])
        kept = matches[own_point[matches[:, own]] == point_of[other][matches[:, 1 - own]]]
        if not len(kept) or not solution.registered[other]:
            continue
        ends = [solution.camera_from_world[other], pose]
        first, second = ends if own else ends[::-1]
        relative = second @ invert_pose(first)
        relative[:3, 3] /= max(float(np.linalg.norm(relative[:3, 3])), 1e-12)
        points = solution.points[own_point[kept[:, own]]]
        a, b = (points - center for center in find_centers(np.stack(ends)))
        sine = np.linalg.norm(np.cross(a, b), axis=1)
        parallax = float(np.percentile(np.arctan2(sine, np.sum(a * b, axis=1)), 75))
        found.append(PairMatches(int(pair[0]), int(pair[1]), kept, relative, 0, parallax))
    return found
