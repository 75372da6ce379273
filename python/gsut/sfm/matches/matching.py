"""Chooses pairs of images and matches their features."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from gsut import _core
from gsut.data.scene import split_last_number
from gsut.least_squares import ROUNDS
from gsut.sampling import ENOUGH_SAMPLES
from gsut.sfm.photographs import Features, OnProgress, PosesOptions, Stages

BATCH = 64  # pairs between two refreshes of the progress bar
_STAGE = "matches"  # name of the stage file
# Visual words that a vocabulary has: enough to rank images by likeness, and quick to find.
_WORDS = 64
ALL_UP_TO = 100  # images, of which all pairs are compared, and all are adjusted several times
WINDOW = 8  # images after each that it is compared with, where names count up
# The largest of an image, by which it is found which images look alike; an image with fewer is
# blurred, dark or without texture.
PREVIEW_FEATURES = 700
_PREVIEW_MATCHES = 8  # of them that must match
# Most images that an image is compared with in full: those with the most matches of the largest
# features.
_MOST_PARTNERS = 24
MAX_RATIO = 0.85  # of the distances of matched descriptors, nearest to second nearest
MAX_DISTANCE = 0.7  # of matched descriptors, of unit length
# Called with (pairs done, pairs in all).
OnPairs = Callable[[int, int], None]


@dataclasses.dataclass(frozen=True)
class PairMatches:
    """Matches of two images that agree with one relative pose.

    Args:
        first, second: the images, first < second.
        matches: (M, 2) int32, feature of the first and of the second image.
        second_from_first: (4, 4), translation of unit length.
        rotation_matches: number of them that a rotation alone explains.
        parallax: radians, upper quartile of the angle between matched rays, rotation undone.
        is_predicted: chosen by poses of both images, which they therefore do not confirm.
    """

    first: int
    second: int
    matches: np.ndarray
    second_from_first: np.ndarray
    rotation_matches: int
    parallax: float
    is_predicted: bool = False

    def as_tuple(self) -> tuple:
        """Returns the tuple that the solver takes."""
        return (
            self.first, self.second, self.matches, self.second_from_first,
            self.rotation_matches, self.parallax,
        )  # fmt: skip


@dataclasses.dataclass(frozen=True)
class RawMatches:
    """Features that look alike, pair by pair, before they are checked against poses or a lens.

    Args:
        pairs: (P, 2) images.
        matches: of each pair (M, 2) int32, feature of the first and of the second image, most
            distinct first.
    """

    pairs: np.ndarray
    matches: list[np.ndarray]


def match_images(
    names: Sequence[str],
    features: Sequence[Features],
    options: PosesOptions,
    on_progress: OnProgress,
    frames: np.ndarray | None = None,
    stages: Stages | None = None,
) -> RawMatches:
    """Matches the features of all pairs of images that look alike.

    Args:
        names, features: of all images.
        on_progress: called for the stages "preview" and "matching".
        frames: of a rig's images, see Photographs.
        stages: where matches are kept; None: nowhere.
    """
    kept = None if stages is None else stages.load(_STAGE)
    if kept is not None:
        ends = np.cumsum(kept["lengths"])
        matches = [kept["matches"][a:b] for a, b in zip(ends - kept["lengths"], ends, strict=True)]
        return RawMatches(kept["pairs"], matches)
    pairs = choose_pairs(names, features, options, frames)

    def match(stage: str, most: int | None) -> Iterator[np.ndarray]:
        descriptors = [f.descriptors[:most] for f in features]  # largest features first
        for begin in range(0, len(pairs), BATCH):
            batch = pairs[begin : begin + BATCH]
            yield from _core.match_pairs(descriptors, batch, MAX_RATIO, MAX_DISTANCE)
            done, total = begin + len(batch), len(pairs)
            on_progress(stage, done, total, f"{total} pairs")

    # The largest features show which pairs match: most pairs of a walk see different things.
    counts = np.array([len(m) for m in match("preview", PREVIEW_FEATURES)], np.int64)
    pairs = _keep_partners(pairs, counts)
    raw = RawMatches(pairs, list(match("matching", None)))
    if stages is not None:
        arrays = {
            "pairs": np.asarray(raw.pairs, np.int64).reshape(-1, 2),
            "lengths": np.array([len(m) for m in raw.matches], np.int64),
            "matches": np.concatenate([np.zeros((0, 2), np.int32), *raw.matches]),
        }
        stages.save(_STAGE, arrays)
    return raw


def _keep_partners(pairs: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Keeps (Q, 2) of pairs (P, 2), each image's best by counts (P,) of matches."""
    good = np.flatnonzero(counts >= _PREVIEW_MATCHES)
    # A pair stays if either of its images keeps it.
    order = good[np.argsort(-counts[good], kind="stable")]
    used = np.zeros(pairs.max(initial=-1) + 1, np.int64)
    kept = []
    for index in order:
        first, second = pairs[index]
        if min(used[first], used[second]) < _MOST_PARTNERS:
            used[first] += 1
            used[second] += 1
            kept.append(index)
    return pairs[sorted(kept)]


def choose_pairs(
    names: Sequence[str],
    features: Sequence[Features],
    options: PosesOptions,
    frames: np.ndarray | None = None,
) -> np.ndarray:
    """Chooses the pairs of images to compare.

    Args:
        names: of the images, in order.
        features: of the images.
        options: `pairs` is the rule.
        frames: (N,) of a rig's images, which are then in order of time; its windows count frames.

    Returns:
        (P, 2) int64, the smaller index first, each pair once, ordered.
    """
    count = len(names)
    rule = options.pairs
    if rule == "auto" and count <= ALL_UP_TO:
        rule = "all"
    if rule == "all":
        first, second = np.triu_indices(count, 1)
        return np.stack([first, second], axis=1).astype(np.int64)
    chosen: list[np.ndarray] = []
    in_time = find_frame_numbers(names, frames) is not None
    if rule == "sequential" or (rule == "auto" and in_time):
        together = 1 if frames is None else int(np.bincount(frames).max())
        chosen.append(_pair_sequential(count, WINDOW * together))
    if rule in ("similar", "auto"):
        chosen.append(_pair_similar(features, options.seed))
    pairs = np.unique(np.sort(np.concatenate(chosen), axis=1), axis=0)
    return pairs[pairs[:, 0] != pairs[:, 1]]


def find_frame_numbers(names: Sequence[str], frames: np.ndarray | None) -> np.ndarray | None:
    """Returns (N,) the frame number of each image, from a rig or a video; None: not known."""
    if frames is None:
        return np.arange(len(names)) if has_growing_numbers(names) else None
    return frames


def has_growing_numbers(names: Sequence[str]) -> bool:
    """Returns whether names are one text around a growing number, like the frames of a video."""
    parts = [split_last_number(name) for name in names]
    if not all(number for _, number, _ in parts):
        return False
    numbers = [int(part[1]) for part in parts]
    return len({(part[0], part[2]) for part in parts}) == 1 and numbers == sorted(numbers)


def _pair_sequential(count: int, window: int) -> np.ndarray:
    """Pairs images up to `window` apart, then those at twice, four times ... the distance."""
    steps = list(range(1, window + 1))
    while steps[-1] * 2 < count:
        steps.append(steps[-1] * 2)
    pairs = [(i, i + step) for i in range(count) for step in steps if i + step < count]
    return np.array(pairs, np.int64).reshape(-1, 2)


def _pair_similar(features: Sequence[Features], seed: int) -> np.ndarray:
    """Pairs the images most alike by aggregated descriptors (VLAD: Jegou et al. 2010)."""
    rng = np.random.default_rng(seed)
    largest = [f.normalize_descriptors(PREVIEW_FEATURES) for f in features]
    everything = np.concatenate(largest)
    if len(everything) < _WORDS:
        return _pair_sequential(len(features), len(features))
    sample = everything[rng.permutation(len(everything))[:ENOUGH_SAMPLES]]
    words = _cluster_descriptors(sample, rng)
    signatures = np.stack([_sum_residuals(d, words) for d in largest])
    likeness = signatures @ signatures.T
    np.fill_diagonal(likeness, -np.inf)
    count = min(_MOST_PARTNERS, len(features) - 1)
    nearest = np.argsort(-likeness, axis=1, kind="stable")[:, :count]
    first = np.repeat(np.arange(len(features)), count)
    return np.stack([first, nearest.ravel()], axis=1).astype(np.int64)


def _cluster_descriptors(sample: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    words = sample[rng.permutation(len(sample))[:_WORDS]].copy()
    for _ in range(ROUNDS):
        nearest = np.argmax(sample @ words.T - 0.5 * (words**2).sum(axis=1), axis=1)
        for word in range(len(words)):
            members = sample[nearest == word]
            if len(members):
                words[word] = members.mean(axis=0)
    return words


def _sum_residuals(descriptors: np.ndarray, words: np.ndarray) -> np.ndarray:
    """Sums each word's differences to its descriptors; (W * 128,) of unit length."""
    total = np.zeros_like(words)
    if len(descriptors):
        nearest = np.argmax(descriptors @ words.T - 0.5 * (words**2).sum(axis=1), axis=1)
        np.add.at(total, nearest, descriptors - words[nearest])
    total = np.sign(total) * np.sqrt(np.abs(total))
    return total.ravel() / max(float(np.linalg.norm(total)), 1e-12)
