"""Pairs of images that the others contradict: two places that look alike, taken for one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gsut import _core
from gsut.lens import Camera
from gsut.sfm.core.features import Features
from gsut.sfm.core.matching import OnPairs, PairMatches, RawMatches
from gsut.sfm.core.options import PosesOptions

# Rotations of pairs are often off by 20 degrees where what both see is flat; a pair of two places
# that look alike is off by any angle.
_BATCH = 64  # pairs between two refreshes of the progress bar
_OFF = np.radians(45.0)
_SCALE = np.radians(8.0)  # of the robust weights
_ROUNDS = 10
_MOST_WEIGHT = 300  # matches of a pair, beyond which it is no surer


def verify(
    features: Sequence[Features],
    cameras: Sequence[Camera],
    raw: RawMatches,
    options: PosesOptions,
    on_pairs: OnPairs = lambda done, total: None,
    shutter: _core.Shutter | None = None,
) -> list[PairMatches]:
    """Keeps what agrees with one relative pose a pair, and with the other pairs' rotations.

    Far quicker than the matching.

    Args:
        features, cameras: of all images.
        raw: see RawMatches.
        options: see PosesOptions.
        on_pairs: told (pairs done, pairs in all).
        shutter: rolling, if it is: matches may then be rolling_error times farther off.

    Returns:
        The pairs with at least min_matches matches that the others do not contradict.
    """
    bearings = [_core.ImageBearings(c, f.pixels) for c, f in zip(cameras, features, strict=True)]
    valid = [b.valid for b in bearings]
    diagonal = max(float(np.hypot(c.width, c.height)) for c in cameras)
    max_error = options.max_two_view_error * diagonal / 1000
    if shutter is not None:
        max_error *= options.rolling_error
    result = []
    for begin in range(0, len(raw.pairs), _BATCH):
        batch = raw.pairs[begin : begin + _BATCH]
        found = [
            m[valid[a][m[:, 0]] & valid[b][m[:, 1]]]
            for (a, b), m in zip(batch, raw.matches[begin : begin + _BATCH], strict=True)
        ]
        verified = _core.verify_pairs(bearings, batch, found, max_error, options.seed)
        for (a, b), matches, (inliers, pose, rotation, parallax, ok) in zip(
            batch, found, verified, strict=True
        ):
            if ok and int(inliers.sum()) >= options.min_matches:
                result.append(
                    PairMatches(int(a), int(b), matches[inliers], pose, rotation, parallax)
                )
        on_pairs(begin + len(batch), len(raw.pairs))
    return without_contradicted(result, len(features))


def without_contradicted(pairs: Sequence[PairMatches], count: int) -> list[PairMatches]:
    """The pairs whose rotations agree with those of all images, as the other pairs tell them.

    Images get rotations from the pairs with most matches first (a spanning tree), then from all
    pairs with robust weights (Chatterjee and Govindu, "Efficient and robust large-scale rotation
    averaging", ICCV 2013).

    Args:
        pairs: verified, of `count` images.
    """
    if len(pairs) < 3:
        return list(pairs)
    first = np.array([pair.first for pair in pairs])
    second = np.array([pair.second for pair in pairs])
    relative = np.array([pair.second_from_first[:3, :3] for pair in pairs])
    weights = np.array([float(min(len(pair.matches), _MOST_WEIGHT)) for pair in pairs])
    rotations = _spanned(first, second, relative, weights, count)
    for _ in range(_ROUNDS):
        off = _offsets(rotations, first, second, relative)
        robust = weights / (1 + (np.linalg.norm(off, axis=1) / _SCALE) ** 2) ** 2
        laplacian = np.zeros((count, count))
        pull = np.zeros((count, 3))
        np.add.at(laplacian, (first, first), robust)
        np.add.at(laplacian, (second, second), robust)
        np.add.at(laplacian, (first, second), -robust)
        np.add.at(laplacian, (second, first), -robust)
        np.add.at(pull, second, robust[:, None] * off)
        np.add.at(pull, first, -robust[:, None] * off)
        laplacian[np.diag_indices(count)] += 1e-6 * weights.mean()  # the world's own rotation
        turns = np.linalg.solve(laplacian, pull)
        rotations = np.array(
            [
                r @ _core.exp_pose(np.concatenate([np.zeros(3), turn]))[:3, :3]
                for r, turn in zip(rotations, turns, strict=True)
            ]
        )
    off = np.linalg.norm(_offsets(rotations, first, second, relative), axis=1)
    return [pair for pair, angle in zip(pairs, off, strict=True) if angle < _OFF]


def _spanned(
    first: np.ndarray, second: np.ndarray, relative: np.ndarray, weights: np.ndarray, count: int
) -> np.ndarray:
    """(N, 3, 3) camera from world along the pairs with most matches."""
    group = np.arange(count)
    rotations = np.tile(np.eye(3), (count, 1, 1))
    for index in np.argsort(-weights, kind="stable"):
        a, b = first[index], second[index]
        if group[a] == group[b]:
            continue
        # The group of b turns as a whole: R_b turn = relative R_a.
        members = group == group[b]
        rotations[members] = rotations[members] @ (rotations[b].T @ relative[index] @ rotations[a])
        group[members] = group[a]
    return rotations


def _offsets(
    rotations: np.ndarray, first: np.ndarray, second: np.ndarray, relative: np.ndarray
) -> np.ndarray:
    """(P, 3) of each pair the turn in the world, radians, that the second is short of the first."""
    wanted = relative @ rotations[first]
    turn = np.swapaxes(rotations[second], 1, 2) @ wanted
    axis = np.stack(
        [turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0],
         turn[:, 1, 0] - turn[:, 0, 1]], axis=1,
    )  # fmt: skip
    sine = 0.5 * np.linalg.norm(axis, axis=1)
    cosine = 0.5 * (np.trace(turn, axis1=1, axis2=2) - 1)
    angle = np.arctan2(sine, cosine)
    return axis * (angle / np.maximum(2 * sine, 1e-12))[:, None]
