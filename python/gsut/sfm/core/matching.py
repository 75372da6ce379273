"""Matches between images: a quick look, all descriptors, then one relative pose a pair."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from gsut import _core
from gsut.sfm.core.features import Features
from gsut.sfm.core.options import PosesOptions

_BATCH = 64  # pairs between two refreshes of the progress bar
# Told (pairs done, pairs in all).
OnPairs = Callable[[int, int], None]


@dataclasses.dataclass(frozen=True)
class PairMatches:
    """Matches of two images that agree with one relative pose.

    Args:
        first, second: the images, first < second.
        matches: (M, 2) int32, feature of the first and of the second image.
        second_from_first: (4, 4), translation of unit length.
        rotation_matches: how many of them a rotation alone explains.
        parallax: radians, upper quartile of the angle between matched rays, rotation undone.
    """

    first: int
    second: int
    matches: np.ndarray
    second_from_first: np.ndarray
    rotation_matches: int
    parallax: float

    def as_tuple(self) -> tuple:
        """As `_core.estimate_poses` takes it."""
        return (
            self.first, self.second, self.matches, self.second_from_first,
            self.rotation_matches, self.parallax,
        )  # fmt: skip


def preview_pairs(
    features: Sequence[Features],
    pairs: np.ndarray,
    options: PosesOptions,
    on_pairs: OnPairs,
) -> np.ndarray:
    """The pairs whose largest features match at all: most pairs of a walk see different things.

    Args:
        features: of all images, largest first.
        pairs: (P, 2).
        options: preview_features, preview_matches and partners.
        on_pairs: told (pairs done, pairs in all).

    Returns:
        (Q, 2), a subset of pairs.
    """
    largest = [f.descriptors[: options.preview_features] for f in features]
    counts = np.zeros(len(pairs), np.int64)
    for begin in range(0, len(pairs), _BATCH):
        batch = pairs[begin : begin + _BATCH]
        found = _core.match_pairs(largest, batch, options.max_ratio, options.max_distance)
        counts[begin : begin + len(batch)] = [len(m) for m in found]
        on_pairs(begin + len(batch), len(pairs))
    good = np.flatnonzero(counts >= options.preview_matches)
    # Of either image the best partners: a pair is kept if one of both wants it.
    order = good[np.argsort(-counts[good], kind="stable")]
    used = np.zeros(len(features), np.int64)
    kept = []
    for index in order:
        first, second = pairs[index]
        if min(used[first], used[second]) < options.partners:
            used[first] += 1
            used[second] += 1
            kept.append(index)
    return pairs[sorted(kept)]


@dataclasses.dataclass(frozen=True)
class RawMatches:
    """Features alike, pair by pair, before anything is asked of poses or lens.

    Args:
        pairs: (P, 2) images.
        matches: of each pair (M, 2) int32, feature of the first and of the second image, most
            distinct first.
    """

    pairs: np.ndarray
    matches: list[np.ndarray]


def match_in_full(
    features: Sequence[Features], pairs: np.ndarray, options: PosesOptions, on_pairs: OnPairs
) -> RawMatches:
    """Compares all features of pairs of images.

    Args:
        features: of all images. pairs: (P, 2). options: max_ratio and max_distance.
        on_pairs: told (pairs done, pairs in all).
    """
    descriptors = [f.descriptors for f in features]
    matches: list[np.ndarray] = []
    for begin in range(0, len(pairs), _BATCH):
        batch = pairs[begin : begin + _BATCH]
        matches += _core.match_pairs(descriptors, batch, options.max_ratio, options.max_distance)
        on_pairs(begin + len(batch), len(pairs))
    return RawMatches(pairs, matches)
