"""Starts the structure again, and keeps what explains the matches best."""

from __future__ import annotations

import contextlib
import dataclasses
import math
from collections.abc import Iterator

import numpy as np

from gsut._core import SolveError
from gsut.gaussians import find_nearest_rotation
from gsut.judge.checks import IMPOSSIBLE_TURN, UNUSABLE
from gsut.sfm.lens import measure_pose_differences
from gsut.sfm.mapping import Mapping
from gsut.sfm.matches import keep_most_distinct
from gsut.sfm.solution import (
    Adjustment,
    LensFlags,
    ReadoutMotion,
    Solution,
    compare_solutions,
    measure_diagonal,
    solve_poses,
)
from gsut.sfm.starts.halves import HALF_INLIERS, MOST_IMAGES, split_matches


def try_other_starts(mapping: Mapping) -> Mapping:
    """Replaces the solution by that of another start, if it explains the matches better.

    A structure that grows image by image may take a wrong turn that no adjustment undoes, and most
    points fit nevertheless: of the two ways to see a plane, or depth, the wrong one, or velocities
    of a rolling shutter that bend the scene. A structure of half of the points seldom takes the
    same turn. Poses are adjusted by all matches from a loose limit on: more of them then agree.
    Velocities of a rolling shutter must pay for themselves.
    Does nothing for a rig, where the readout time is given, or without points.

    Returns:
        The run with the solution.
    """
    solution = mapping.solved
    is_timed = mapping.options.readout_time is not None
    if mapping.rig is not None or is_timed or not len(solution.points):
        return mapping
    still = dataclasses.replace(solution, shutter=None, velocities=None)
    moves = solution.velocities is not None
    best = first = _adjust(mapping, still, None if moves else mapping.lens_free) or solution
    for start in _find_others(mapping, still):
        found = _adjust(mapping, start, None)
        if found is not None and _is_better(mapping, best, found):
            best = found
    if solution.velocities is not None and best is not solution:
        more_free = solution.velocities[solution.registered].size
        if _is_better(mapping, best, solution, more_free):
            return mapping
    if (moves or best is not first) and mapping.lens_free is not None:
        best = _adjust(mapping, best, mapping.lens_free) or best
    return mapping.replace(solution=best)


def _is_better(mapping: Mapping, current: Solution, rival: Solution, more_free: int = 0) -> bool:
    """Returns whether a rival explains the verified matches better beyond chance.

    Images that turn as no camera does while they are read are impossible, whatever they explain.
    """
    bent, also = ((each.readout_turn or 0.0) > IMPOSSIBLE_TURN for each in (current, rival))
    prior = 0.0 if bent == also else math.inf if bent else -math.inf
    pairs, features = mapping.pairs, mapping.features
    return compare_solutions(current, rival, features, pairs, more_free, prior).is_rival


def _adjust(mapping: Mapping, start: Solution, lens_free: LensFlags) -> Solution | None:
    """Adjusts a start by all matches, from a loose limit on; None if they do not hold it."""
    shutter, motion = mapping.solved.shutter, None
    if shutter is not None:  # velocities near none, or what matches demand beyond
        motion = ReadoutMotion(shutter, 1.0, np.zeros((len(start.names), 6)))
    try:
        adjustment = Adjustment(lens_free, motion=motion, extend=True)
        return mapping.adjust(adjustment, start, stage="mapping")
    except SolveError:
        return None


def _find_others(mapping: Mapping, still: Solution) -> Iterator[Solution]:
    """Finds structures of either half of the points, and yields those that are not the same.

    Each begins with another pair of images: a wrong turn is mostly that of the first pair, and
    halves would choose the same one. Before them the structure turned inside out.
    """
    few = keep_most_distinct(mapping.pairs)
    limit = UNUSABLE * measure_diagonal(still.cameras)

    def is_other(found: Solution) -> bool:
        # Of which one pair in ten is farther off, no adjustment makes the same structure.
        differences = measure_pose_differences(found, still, still)
        return bool(np.quantile(differences, 0.9, method="higher") > limit)

    with contextlib.suppress(SolveError):
        found = mapping.adjust(Adjustment(covariances=False), _turn_inside_out(still), few)
        if is_other(found) and compare_solutions(still, found, mapping.features, few).gain > 0:
            yield found
    if still.num_registered > MOST_IMAGES:
        return
    images = dataclasses.replace(mapping.images, cameras=still.cameras, shutter=None)
    begun = {still.initial_pair}
    for half in split_matches(mapping):
        others = [pair for pair in half if (pair.first, pair.second) not in begun]
        try:
            found = solve_poses(
                images, others, mapping.options, mapping.log.follow_steps("mapping"),
                Adjustment(lens_settled=True, covariances=False, min_inliers=HALF_INLIERS),
            )  # fmt: skip
        except SolveError:
            continue
        begun.add(found.initial_pair)
        if is_other(found):
            yield found


def _turn_inside_out(solution: Solution) -> Solution:
    """Turns a structure inside out: depth is mirrored, cameras turn the other way.

    Where rays are nearly parallel, as of narrow views of what is far, images stay the same
    (Necker's reversal; Ullman, "The interpretation of structure from motion", 1979).
    """
    poses, mirror = solution.camera_from_world.copy(), np.diag([1.0, 1.0, -1.0])
    known = poses[solution.registered]
    middle = find_nearest_rotation(known[:, :3, :3].mean(axis=0))
    center = np.median(solution.points, axis=0)
    seen = known[:, :3, :3] @ center + known[:, :3, 3]  # stays where it is in each image
    turned = mirror @ known[:, :3, :3] @ middle.T @ mirror @ middle
    known[:, :3, :3], known[:, :3, 3] = turned, seen - turned @ center
    poses[solution.registered] = known
    return dataclasses.replace(solution, camera_from_world=poses)
