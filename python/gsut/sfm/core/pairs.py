"""Which images are compared with each other."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from gsut.sfm.core.features import Features
from gsut.sfm.core.options import PosesOptions

_WORDS = 64  # of the vocabulary that tells which images are alike
_SAMPLE = 20000  # descriptors from which the vocabulary is made
_WORD_FEATURES = 500  # of each image, largest first
_ROUNDS = 8  # of k-means: the vocabulary need not be exact


def choose_pairs(
    names: Sequence[str],
    features: Sequence[Features],
    options: PosesOptions,
    frames: np.ndarray | None = None,
) -> np.ndarray:
    """Pairs of images worth a comparison.

    Args:
        names: of the images, in order.
        features: of the images.
        options: see PosesOptions.pairs.
        frames: (N,) of a rig's images, which are then in order of time; its windows count frames.

    Returns:
        (P, 2) int64, the smaller index first, each pair once, ordered.
    """
    count = len(names)
    rule = options.pairs
    if rule == "auto" and count <= options.all_up_to:
        rule = "all"
    if rule == "all":
        first, second = np.triu_indices(count, 1)
        return np.stack([first, second], axis=1).astype(np.int64)
    chosen: list[np.ndarray] = []
    in_time = times_of(names, frames) is not None
    if rule == "sequential" or (rule == "auto" and in_time):
        together = 1 if frames is None else int(np.bincount(frames).max())
        chosen.append(_sequential(count, options.window * together))
    if rule in ("similar", "auto"):
        chosen.append(_similar(features, options.neighbors, options.seed))
    pairs = np.unique(np.sort(np.concatenate(chosen), axis=1), axis=0)
    return pairs[pairs[:, 0] != pairs[:, 1]]


def times_of(names: Sequence[str], frames: np.ndarray | None) -> np.ndarray | None:
    """(N,) number of each image's frame in time, as far as names or a rig's frames tell."""
    if frames is None:
        return np.arange(len(names)) if counts_up(names) else None
    return frames


def counts_up(names: Sequence[str]) -> bool:
    """Whether the names are one text around a number that grows: the frames of a video."""
    found = [re.fullmatch(r"(.*?)(\d+)(\D*)", name) for name in names]
    if not all(found):
        return False
    parts = [match.groups() for match in found if match]
    numbers = [int(part[1]) for part in parts]
    return len({(part[0], part[2]) for part in parts}) == 1 and numbers == sorted(numbers)


def _sequential(count: int, window: int) -> np.ndarray:
    """Each with the next `window`, then with those at twice, four times ... the distance."""
    steps = list(range(1, window + 1))
    while steps[-1] * 2 < count:
        steps.append(steps[-1] * 2)
    pairs = [(i, i + step) for i in range(count) for step in steps if i + step < count]
    return np.array(pairs, np.int64).reshape(-1, 2)


def _similar(features: Sequence[Features], neighbors: int, seed: int) -> np.ndarray:
    """The most alike by aggregated descriptors (VLAD: Jegou et al. 2010)."""
    rng = np.random.default_rng(seed)
    largest = [f.unit_descriptors(_WORD_FEATURES) for f in features]
    everything = np.concatenate(largest)
    if len(everything) < _WORDS:
        return _sequential(len(features), len(features))
    sample = everything[rng.permutation(len(everything))[:_SAMPLE]]
    words = _k_means(sample, rng)
    signatures = np.stack([_signature(d, words) for d in largest])
    likeness = signatures @ signatures.T
    np.fill_diagonal(likeness, -np.inf)
    count = min(neighbors, len(features) - 1)
    nearest = np.argsort(-likeness, axis=1, kind="stable")[:, :count]
    first = np.repeat(np.arange(len(features)), count)
    return np.stack([first, nearest.ravel()], axis=1).astype(np.int64)


def _k_means(sample: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    words = sample[rng.permutation(len(sample))[:_WORDS]].copy()
    for _ in range(_ROUNDS):
        nearest = np.argmax(sample @ words.T - 0.5 * (words**2).sum(axis=1), axis=1)
        for word in range(len(words)):
            members = sample[nearest == word]
            if len(members):
                words[word] = members.mean(axis=0)
    return words


def _signature(descriptors: np.ndarray, words: np.ndarray) -> np.ndarray:
    """Sum of what differs from the nearest word, word by word; of unit length."""
    total = np.zeros_like(words)
    if len(descriptors):
        nearest = np.argmax(descriptors @ words.T - 0.5 * (words**2).sum(axis=1), axis=1)
        np.add.at(total, nearest, descriptors - words[nearest])
    total = np.sign(total) * np.sqrt(np.abs(total))
    return total.ravel() / max(float(np.linalg.norm(total)), 1e-12)
