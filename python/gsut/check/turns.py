"""What turns of the photographs against each other say of the poses' rotations.

Matches of two images tell the turn between them without the given poses; where these are wrong in
a way that no matrix mends, their turns still tell how.
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
from gsut.sfm.core import measure_angular_errors

MATCHED = 0.5  # of the matches must fit one relative pose a pair, for there to be evidence
_FEWEST = 4  # turns from which something is told
_EXPLAINED = 0.5  # cost of poses, see `cost`, that need no other start
_TILTS, _STARTS = (-0.3, 0.0, 0.3), 12  # radians about each axis; tilts that are refined
_WIDEST, _FINEST = 0.2, 0.005  # steps of the search for a camera's turn on its body; radians
_AGREE = 2.5  # degrees, median, of turns that are explained
_BETTER = 0.5  # of the given turns' error, at most
_SHARE = 0.7  # of the turns
_CLOCKS = (-0.75, -0.5, -0.25, 0.25, 0.5, 0.75)  # frames


def turn_of_body(evidence: Evidence) -> np.ndarray:
    """(4, 4) body_from_camera, a rotation: turns of cameras against turns of the given poses.

    Rotation vectors of both differ by the rotation sought (hand-eye calibration; Kabsch). Where
    that does not explain the matches, as turns are less exact under a rolling shutter, the 24 ways
    to name the camera's axes are starts of a search for the smallest median error. What is found is
    refined so that most matches fit.
    """
    sample, found = evidence.sample, list(_turns(evidence))
    tried = []
    if len(found) >= _FEWEST:
        tried.append(_refined(sample, _hand_eye(evidence, found), Evidence.cost_of_poses))
    if not tried or sample.cost_of_poses(evidence.table.poses @ tried[0]) > _EXPLAINED:
        tried.append(_searched(sample))
    return min(tried, key=lambda turn: sample.cost_of_poses(evidence.table.poses @ turn))


def _hand_eye(
    evidence: Evidence, found: Sequence[tuple[tuple[int, int], np.ndarray]]
) -> np.ndarray:
    given = [rotation_vector(_given(evidence, *views)) for views, _ in found]
    left, _, right = np.linalg.svd(
        np.array(given).T @ np.array([rotation_vector(turn) for _, turn in found])
    )
    flip = np.diag([1.0, 1.0, np.linalg.det(left @ right)])
    turn = np.eye(4)
    turn[:3, :3] = left @ flip @ right
    return turn


def _searched(evidence: Evidence) -> np.ndarray:
    """The turn at which most matches fit, of those near one of the 24, or between them, that have
    the smallest median errors."""
    starts = []
    for axes in list_signed_permutations():
        for tilt in itertools.product(_TILTS, repeat=3) if np.linalg.det(axes) > 0 else ():
            start = np.eye(4)
            start[:3, :3] = axes @ exp_pose([0.0, 0.0, 0.0, *tilt])[:3, :3]
            starts.append((_median_error(evidence, evidence.table.poses @ start), start))
    starts.sort(key=lambda each: each[0])
    near = [_refined(evidence, start, _median_error) for _, start in starts[:_STARTS]]
    turns = [_refined(evidence, turn, Evidence.cost_of_poses) for turn in near]
    return min(turns, key=lambda turn: evidence.cost_of_poses(evidence.table.poses @ turn))


def _median_error(evidence: Evidence, poses: np.ndarray) -> float:
    """Radians; infinite where most matches have no rays."""
    errors = measure_angular_errors(evidence.rays, evidence.table.of_matches(poses))
    return float(np.median(np.where(np.isfinite(errors), errors, np.inf)))


def _refined(
    evidence: Evidence, turn: np.ndarray, cost_of: Callable[[Evidence, np.ndarray], float]
) -> np.ndarray:
    """The turn near another one at which poses cost least: a search by ever smaller steps."""
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


def read_in_degrees(evidence: Evidence) -> float | None:
    """Share of the turns that fit if rotation vectors in degrees were read as radians, or None.

    A rotation read so has its axis, and an angle that is 180 / pi times the right one, less full
    turns: 58 angles may have been meant, some of which fit the neighbour's.
    """
    found = list(_turns(evidence))
    if len(found) < _FEWEST:
        return None
    shares = []
    for file_axes in (np.eye(3), OPENGL_FROM_OPENCV[:3, :3]):
        good = 0
        for (a, b), turn in found:
            one, two = (
                _meant(evidence.scene.views[i].camera_from_world[:3, :3].T @ file_axes)
                for i in (a, b)
            )
            # turn = W_b^T W_a of camera-to-world rotations W; files have W @ file_axes.
            reached = one @ (file_axes.T @ turn.T @ file_axes)
            traces = np.einsum("iab,jab->ij", reached, two)
            good += np.degrees(np.arccos(np.clip((traces.max() - 1) / 2, -1, 1))) < _AGREE
        shares.append(good / len(found))
    return max(shares) if max(shares) >= _SHARE else None


def _meant(rotation: np.ndarray) -> np.ndarray:
    """(K, 3, 3) the rotations whose angle, times 180 / pi, is this one's."""
    vector = rotation_vector(rotation)
    angle = np.linalg.norm(vector)
    axis = vector / max(float(angle), 1e-12)
    full = 2 * np.pi * np.arange(0, 30)
    angles = np.radians(np.concatenate([angle + full, angle - full]))
    angles = angles[np.abs(angles) <= np.pi]
    halves = angles[:, None] / 2
    return rotations_from_quaternions(
        np.concatenate([np.cos(halves), np.sin(halves) * axis], axis=1)
    )


def clock_of_turns(evidence: Evidence) -> float | None:
    """By how many frames poses are late where each turn is a mixture of two neighbouring ones."""
    turns = {views: turn for views, turn in _turns(evidence)}
    triples = []
    for (a, b), first in turns.items():
        for (c, d), whole in turns.items():
            if a == c and b != d and (b - a) * (d - b) > 0:
                triples.append((a, b, d, first, whole @ first.T))
    if len(triples) < _FEWEST:
        return None
    before = np.median([_apart(first, _given(evidence, a, b)) for a, b, _, first, _ in triples])
    errors = {}
    for late in _CLOCKS:
        share = abs(late)
        off = []
        for a, b, d, first, second in triples:
            mixed = _power(second, share) @ _power(first, 1 - share)
            if late < 0:
                mixed = _power(second, 1 - share) @ _power(first, share)
            off.append(_apart(mixed, _given(evidence, *((a, b) if late > 0 else (b, d)))))
        errors[late] = float(np.median(off))
    best = min(errors, key=lambda late: errors[late])
    return best if errors[best] < min(_AGREE, _BETTER * before) else None


def _turns(evidence: Evidence) -> Iterator[tuple[tuple[int, int], np.ndarray]]:
    """Views, and the rotation second_from_first, of the pairs that have one."""
    for number, turn, share in evidence.free_turns:
        if share >= MATCHED:
            pair = evidence.pairs[number]
            yield (pair.first, pair.second), turn


def _given(evidence: Evidence, first: int, second: int) -> np.ndarray:
    one, two = (evidence.scene.views[i].camera_from_world[:3, :3] for i in (first, second))
    return two @ one.T


def _power(rotation: np.ndarray, share: float) -> np.ndarray:
    return exp_pose([0.0, 0.0, 0.0, *(share * rotation_vector(rotation))])[:3, :3]


def _apart(one: np.ndarray, other: np.ndarray) -> float:
    """Degrees between two rotations."""
    return float(np.degrees(np.linalg.norm(rotation_vector(one @ other.T))))


def rotation_vector(rotation: np.ndarray) -> np.ndarray:
    """(3,) axis times angle of a rotation (3, 3)."""
    r = rotation
    sine = np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]]) / 2
    length = np.linalg.norm(sine)
    angle = np.arctan2(length, (np.trace(r) - 1) / 2)
    return sine * (angle / length if length > 1e-12 else 1.0)
