"""Leaves out images that stand at a wrong place by what their matches say."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np

from gsut._core import SolveError
from gsut.data import list_some
from gsut.judge.checks import NOT_GOOD
from gsut.sfm.mapping import Mapping
from gsut.sfm.matches import PairMatches, RawMatches, group_images
from gsut.sfm.solution import (
    Adjustment,
    LookAlikes,
    ReadoutMotion,
    Solution,
    measure_agreement,
    measure_diagonal,
)
from gsut.sfm.starts.halves import measure_halves


def leave_out_contradicted(mapping: Mapping) -> Mapping:
    """Leaves out images that no pair which the structure upholds joins with most of the others.

    A pose that chance suggests, or things that look alike, fits the matches of one pair after the
    other, but less than half of them observe a point: with the points of a third image they do not
    agree. Learned features find such pairs; without them nothing is done, nor where either half of
    the points gives the same poses.

    Args:
        mapping: with solution and pairs.

    Returns:
        The run without these images, and without the matches that join images which no such pairs
        connect.

    Raises:
        SolveError: no two images are left.
    """
    solution = mapping.solved
    if all(each.is_learned is None for each in mapping.features):
        return mapping
    group = _group_upheld(solution, [pair for pair in mapping.pairs if not pair.is_predicted])
    if not group.any():
        return mapping
    off = measure_halves(mapping)
    if off is not None and off[0] <= NOT_GOOD * measure_diagonal(solution.cameras):
        return mapping
    separated = _separate(mapping, group)
    names = [solution.names[image] for image in np.flatnonzero(group)]
    mapping.log.note(
        "left out after all, as most of their matches contradict the poses that fit best: "
        f"{list_some(names)}"
    )
    return separated


def leave_out_look_alikes(mapping: Mapping, found: LookAlikes | None) -> Mapping:
    """Leaves out the smaller part of images that show places which were taken for one.

    Args:
        mapping: with solution and pairs.
        found: see `separate_look_alikes`.

    Returns:
        The run; as given where not doubted, where the parts are not clear, or where the images of
        the larger part do not hold their poses without the others.
    """
    if found is None or not found.smaller:
        return mapping
    left = np.isin(mapping.solved.names, found.smaller)
    try:
        separated = _separate(mapping, left.astype(int))
    except SolveError:
        return mapping
    others = [name for name in found.images if name not in found.smaller]
    mapping.log.note(
        f"left out after all, as they show a place that looks like that of {list_some(others)}: "
        f"{list_some(found.smaller)}"
    )
    return separated


def _group_upheld(solution: Solution, pairs: list[PairMatches]) -> np.ndarray:
    """Numbers images (N,) by groups that pairs connect which the structure upholds.

    0: the most images, and those without a pose.
    """
    known = [p for p in pairs if solution.registered[p.first] and solution.registered[p.second]]
    upheld = measure_agreement(solution, pairs).upheld
    group = 1 + group_images(list(itertools.compress(known, upheld)), len(solution.names))
    views = np.bincount(solution.observations[:, 1], minlength=len(group))
    sizes = {number: (np.sum(group == number), views[group == number].sum()) for number in group}
    return np.where(solution.registered & (group != max(sizes, key=sizes.__getitem__)), group, 0)


def _separate(mapping: Mapping, group: np.ndarray) -> Mapping:
    """Adjusts the images of group (N,) 0 alone, and drops the matches that join two groups."""
    solution = mapping.solved
    start = dataclasses.replace(solution, registered=solution.registered & (group == 0))
    inside = [i for i, (a, b) in enumerate(mapping.raw.pairs) if group[a] == group[b]]
    pairs = [pair for pair in mapping.pairs if group[pair.first] == group[pair.second]]
    motion = ReadoutMotion.follow(solution)
    adjustment = Adjustment(mapping.lens_free, motion=motion, extend=True, turns=mapping.turns)
    return mapping.replace(
        raw=RawMatches(mapping.raw.pairs[inside], [mapping.raw.matches[i] for i in inside]),
        pairs=pairs,
        solution=mapping.adjust(adjustment, start, pairs, "mapping"),
    )
