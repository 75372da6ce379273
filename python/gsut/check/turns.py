"""Compares turns between photographs with those of the given poses.

Matches of two images give the turn between them without the given poses. Where these are wrong in
a way that no matrix mends, their turns still show how.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from gsut._core import exp_pose
from gsut.check.evidence import Evidence
from gsut.check.readings import list_signed_permutations
from gsut.data.poses import OPENGL_FROM_OPENCV
from gsut.gaussians import rotations_from_quaternions
from gsut.sfm.points import measure_angular_errors

MATCHED = 0.5  # of a pair's matches must fit one relative pose for it to count
_FEWEST = 4  # turns: fewer show nothing
_EXPLAINED = 0.5  # cost of poses, see `rate_matches`, that need no other start
_TILTS = (-0.3, 0.0, 0.3)  # radians about each axis, from which the search for a turn starts
_STARTS = 12  # best starts that are refined: a refinement takes a tenth of a second
_WIDEST = 0.2  # radians: first step of the search, a bit less than between two tilts
_FINEST = 0.005  # radians: last step, about the error of a turn
_AGREE = 2.5  # degrees: median error of turns that are explained
_BETTER = 0.5  # of the given turns' error, that an explanation may leave at most
_SHARE = 0.7  # of the turns, that an explanation must fit
_CLOCKS = (-0.75, -0.5, -0.25, 0.25, 0.5, 0.75)  # frames by which poses may be late


def find_body_turn(evidence: Evidence) -> np.ndarray:
    """Finds the rotation body_from_camera (4, 4) from turns of cameras and of the given poses.

    Rotation vectors of both differ by the rotation sought (hand-eye calibration; Kabsch). Where
    that does not explain the matches, as turns are less exact under a rolling shutter, the 24 ways
    to name the camera's axes are starts of a search for the smallest median error. What is found is
    refined so that most matches fit.
    """
    sample, found = evidence.sample, list(_list_turns(evidence))
    tried = []
    if len(found) >= _FEWEST:
        tried.append(refine_turn(sample, _align_turns(evidence, found), Evidence.rate_poses))
    if not tried or sample.rate_poses(evidence.table.poses @ tried[0]) > _EXPLAINED:
        tried.append(_search_turn(sample))
    return min(tried, key=lambda turn: sample.rate_poses(evidence.table.poses @ turn))


def _align_turns(
    evidence: Evidence, found: Sequence[tuple[tuple[int, int], np.ndarray]]
) -> np.ndarray:
    given = [to_rotation_vector(_find_given_turn(evidence, *views)) for views, _ in found]
    left, _, right = np.linalg.svd(
        np.array(given).T @ np.array([to_rotation_vector(turn) for _, turn in found])
    )
    flip = np.diag([1.0, 1.0, np.linalg.det(left @ right)])
    turn = np.eye(4)
    turn[:3, :3] = left @ flip @ right
    return turn


def _search_turn(evidence: Evidence) -> np.ndarray:
    """Refines the starts with the smallest median errors; returns the turn with the least cost."""
    starts = []
    for axes in list_signed_permutations():
        for tilt in itertools.product(_TILTS, repeat=3) if np.linalg.det(axes) > 0 else ():
            start = np.eye(4)
            start[:3, :3] = axes @ exp_pose([0.0, 0.0, 0.0, *tilt])[:3, :3]
            starts.append((_find_median_error(evidence, evidence.table.poses @ start), start))
    starts.sort(key=lambda each: each[0])
    near = [refine_turn(evidence, start, _find_median_error) for _, start in starts[:_STARTS]]
    turns = [refine_turn(evidence, turn, Evidence.rate_poses) for turn in near]
    return min(turns, key=lambda turn: evidence.rate_poses(evidence.table.poses @ turn))


def _find_median_error(evidence: Evidence, poses: np.ndarray) -> float:
    """Returns radians; infinite if most matches have no rays."""
    errors = measure_angular_errors(evidence.rays, evidence.table.select_poses(poses))
    return float(np.median(np.where(np.isfinite(errors), errors, np.inf)))


def refine_turn(
    evidence: Evidence, turn: np.ndarray, cost_of: Callable[[Evidence, np.ndarray], float]
) -> np.ndarray:
    """Searches the turn near this one at which poses cost least, by ever smaller steps."""
    poses = evidence.table.poses
    best, step = cost_of(evidence, poses @ turn), _WIDEST
    while step > _FINEST:
        before = best
        for axis, sign in itertools.product(range(3), (-1.0, 1.0)):
            moved = np.zeros(6)
            moved[3 + axis] = sign * step
            trial = turn @ exp_pose(moved)
            value = cost_of(evidence, poses @ trial)
            if value < best:
                best, turn = value, trial
        if best == before:
            step /= 2
    return turn


def rate_as_degrees(evidence: Evidence) -> float | None:
    """Returns the share of turns that fit if degrees were read as radians, or None if few do.

    A rotation read so has its axis, and an angle that is 180 / pi times the right one, less full
    turns: 58 angles may have been meant. Some of them nearly fit any turn about the same axis, so
    turns must fit far better than those of other pairs do.
    """
    found = list(_list_turns(evidence))
    if len(found) < _FEWEST:
        return None
    views, turns = [views for views, _ in found], np.array([turn for _, turn in found])
    shares = []
    for file_axes in (np.eye(3), OPENGL_FROM_OPENCV[:3, :3]):
        pairs = [
            [_read_as_degrees(evidence.scene.views[i].camera_from_world[:3, :3].T @ file_axes)
             for i in pair]
            for pair in views
        ]  # fmt: skip
        off = _measure_from_nearest(pairs, turns, file_axes)
        by_chance = _measure_from_nearest(pairs, np.roll(turns, 1, axis=0), file_axes)
        if np.median(off) < _BETTER * np.median(by_chance):
            shares.append(float(np.mean(off < _AGREE)))
    best = max(shares, default=0.0)
    return best if best >= _SHARE else None


def _measure_from_nearest(
    pairs: Sequence[Sequence[np.ndarray]], turns: np.ndarray, file_axes: np.ndarray
) -> np.ndarray:
    """Returns the degrees between turns and the nearest of the turns that rotations may mean.

    Args:
        pairs: of each pair the rotations (K, 3, 3) that either view may have.
        turns: (P, 3, 3) second_from_first of each pair.
        file_axes: (3, 3) camera axes of the rotations.
    """
    off = []
    for (one, two), turn in zip(pairs, turns, strict=True):
        # turn = W_b^T W_a of camera-to-world rotations W; files have W @ file_axes.
        reached = one @ (file_axes.T @ turn.T @ file_axes)
        trace = np.einsum("iab,jab->ij", reached, two).max()
        off.append(np.degrees(np.arccos(np.clip((trace - 1) / 2, -1, 1))))
    return np.array(off)


def _read_as_degrees(rotation: np.ndarray) -> np.ndarray:
    """Returns the rotations (K, 3, 3) whose angle, times 180 / pi, is this one's."""
    vector = to_rotation_vector(rotation)
    angle = np.linalg.norm(vector)
    axis = vector / max(float(angle), 1e-12)
    full = 2 * np.pi * np.arange(0, 30)
    angles = np.radians(np.concatenate([angle + full, angle - full]))
    angles = angles[np.abs(angles) <= np.pi]
    halves = angles[:, None] / 2
    return rotations_from_quaternions(
        np.concatenate([np.cos(halves), np.sin(halves) * axis], axis=1)
    )


def find_clock_shift(evidence: Evidence) -> float | None:
    """Finds by how many frames poses are late, if each turn mixes two neighbouring ones."""
    turns = {views: turn for views, turn in _list_turns(evidence)}
    triples = []
    for (a, b), first in turns.items():
        for (c, d), whole in turns.items():
            if a == c and b != d and (b - a) * (d - b) > 0:
                triples.append((a, b, d, first, whole @ first.T))
    if len(triples) < _FEWEST:
        return None
    before = np.median(
        [_measure_angle(first, _find_given_turn(evidence, a, b)) for a, b, _, first, _ in triples]
    )
    errors = {}
    for late in _CLOCKS:
        share = abs(late)
        off = []
        for a, b, d, first, second in triples:
            mixed = _scale_turn(second, share) @ _scale_turn(first, 1 - share)
            if late < 0:
                mixed = _scale_turn(second, 1 - share) @ _scale_turn(first, share)
            off.append(
                _measure_angle(mixed, _find_given_turn(evidence, *((a, b) if late > 0 else (b, d))))
            )
        errors[late] = float(np.median(off))
    best = min(errors, key=lambda late: errors[late])
    return best if errors[best] < min(_AGREE, _BETTER * before) else None


def _list_turns(evidence: Evidence) -> Iterator[tuple[tuple[int, int], np.ndarray]]:
    """Yields both views and the rotation second_from_first of each pair that has one."""
    for number, turn, share in evidence.free_turns:
        if share >= MATCHED:
            pair = evidence.pairs[number]
            yield (pair.first, pair.second), turn


def _find_given_turn(evidence: Evidence, first: int, second: int) -> np.ndarray:
    one, two = (evidence.scene.views[i].camera_from_world[:3, :3] for i in (first, second))
    return two @ one.T


def _scale_turn(rotation: np.ndarray, share: float) -> np.ndarray:
    return exp_pose([0.0, 0.0, 0.0, *(share * to_rotation_vector(rotation))])[:3, :3]


def _measure_angle(one: np.ndarray, other: np.ndarray) -> float:
    """Returns the degrees between two rotations."""
    return float(np.degrees(np.linalg.norm(to_rotation_vector(one @ other.T))))


def to_rotation_vector(rotation: np.ndarray) -> np.ndarray:
    """Returns axis times angle (3,) of a rotation (3, 3)."""
    r = rotation
    sine = np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]]) / 2
    length = np.linalg.norm(sine)
    angle = np.arctan2(length, (np.trace(r) - 1) / 2)
    return sine * (angle / length if length > 1e-12 else 1.0)
