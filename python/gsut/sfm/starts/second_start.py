"""Starts the structure again, and keeps what most matches agree with."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from gsut._core import SolveError
from gsut.judge.checks import has_bent
from gsut.sfm.mapping import Mapping
from gsut.sfm.solution import (
    Adjustment,
    LensFlags,
    ReadoutMotion,
    Solution,
    adjust_registered,
    measure_agreement,
    measure_diagonal,
    solve_poses,
)
from gsut.sfm.starts.halves import HALF_INLIERS, measure_differences, split_matches

# Error over the diagonal that one in ten pairs of images exceeds where two structures are not the
# same one: no adjustment brings them together.
_OTHER = 0.017
_MOST_IMAGES = 200  # of which a structure is found twice more
# Of images of which nothing is known but that lines are read one after the other: velocities stay
# within 0.002 radians, and a thousandth of the distance, or what matches demand beyond.
_STEADY = 0.1
# Share of the matches that another structure must have more, and individual velocities too.
_WORTH = 0.03


def try_other_starts(mapping: Mapping) -> Mapping:
    """Replaces the solution by that of another start, if more matches agree with it.

    A structure that grows image by image may take a wrong turn that no adjustment undoes, and most
    points fit nevertheless: of the two ways to see a plane the wrong one, or velocities of a
    rolling shutter that bend the scene: where images turn as no camera does, any other start is
    better. A structure of half of the points seldom takes the same turn.
    Poses found through a known lens are adjusted once more in any case, from a loose limit on:
    more of the matches then agree with them. Does nothing for a rig, for a film, whose shutter is
    found later, where the readout time is given, or without points.

    Returns:
        The run with the solution.
    """
    solution = mapping.solved
    is_rolling = solution.shutter is not None
    is_timed = bool(mapping.photographs.flows) or mapping.options.readout_time is not None
    if mapping.rig is not None or is_timed or not len(solution.points):
        return mapping
    best, most = solution, _count_agreeing(mapping, solution)
    if has_bent(solution.readout_turn, agreement=1.0):  # whatever agrees
        most = 0
    still = dataclasses.replace(solution, shutter=None, velocities=None)
    if is_rolling or mapping.lens_free is None:
        found, agreeing = _adjust(mapping, still, None)
        if agreeing > most * (1 - _WORTH if is_rolling else 1):
            best, most = found, agreeing
        elif is_rolling and most > 0:
            return mapping  # velocities are needed, and structures without them say nothing
    for start in _find_others(mapping, still):
        found, agreeing = _adjust(mapping, start, None)
        if agreeing > most * (1 + _WORTH):
            best, most = found, agreeing
    if best is not solution and mapping.lens_free is not None:
        best = _adjust(mapping, best, mapping.lens_free)[0]
    return mapping.replace(solution=best)


def _adjust(mapping: Mapping, start: Solution, lens_free: LensFlags) -> tuple[Solution, int]:
    """Adjusts a start by all matches, from a loose limit on.

    Returns:
        The poses, and the number of matches that agree; the mapping's own, and none, where the
        matches do not hold the start.
    """
    shutter, motion = mapping.solved.shutter, None
    if shutter is not None:
        motion = ReadoutMotion(shutter, 1.0, np.zeros((len(start.names), 6)), _STEADY)
    try:
        found = adjust_registered(
            start, mapping.features, mapping.pairs, mapping.options,
            mapping.log.follow_steps("mapping"),
            Adjustment(lens_free, motion=motion, extend=True),
        )  # fmt: skip
    except SolveError:
        return mapping.solved, 0
    return found, _count_agreeing(mapping, found)


def _count_agreeing(mapping: Mapping, solution: Solution) -> int:
    """Counts the matches that observe one point."""
    return int(measure_agreement(solution, mapping.pairs).together.sum())


def _find_others(mapping: Mapping, still: Solution) -> Iterator[Solution]:
    """Finds structures of either half of the points, and yields those that are not the same."""
    if still.num_registered > _MOST_IMAGES:
        return
    images = dataclasses.replace(mapping.images, cameras=still.cameras, shutter=None)
    limit = _OTHER * measure_diagonal(still.cameras)
    for half in split_matches(mapping):
        try:
            found = solve_poses(
                images, half, mapping.options, mapping.log.follow_steps("mapping"),
                Adjustment(lens_settled=True, covariances=False, min_inliers=HALF_INLIERS),
            )  # fmt: skip
        except SolveError:
            continue
        differences = measure_differences(found, still, still)
        if np.quantile(differences, 0.9, method="higher") > limit:
            yield found
