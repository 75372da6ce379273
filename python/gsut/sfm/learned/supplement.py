"""Adds learned features to the photographs that SIFT does not connect."""

from __future__ import annotations

import itertools
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.sfm.learned.attention import MOST_MATCHED, match_by_attention
from gsut.sfm.learned.detection import detect_learned
from gsut.sfm.learned.weights import INSTALL, MATCHER, Weights, find_weights, read_weights
from gsut.sfm.mapping import Mapping
from gsut.sfm.matches import FEW_IMAGES, MAX_DISTANCE, RawMatches, verify_matches
from gsut.sfm.photographs import Features, make_no_features, read_features

_MOST_IMAGES = 40  # up to which learned features are tried
_TURNS = 4  # quarter turns in which an image may have been stored
# Distance of descriptors up to which matches count that show how an image is turned: at the right
# turn dozens are as near, at others a handful.
_NEAR = 0.5


def add_learned_features(mapping: Mapping, absent: np.ndarray) -> Mapping | None:
    """Adds learned features to all images, and their matches to all pairs.

    SIFT's features and matches stay as they are, with the same numbers. An image that is left out
    is turned upright where that gives more near matches: the network knows upright pictures.

    Args:
        mapping: with features and matches.
        absent: (N,) bool, the images that SIFT leaves out.

    Returns:
        The run with more features and matches, verified where the lenses are known; None where
        the network is not installed, which a note says, for a rig, or where the images are many.
    """
    if len(absent) > _MOST_IMAGES or mapping.rig is not None:
        return None
    path, matcher = find_weights(), find_weights(MATCHER)
    if path is None or matcher is None:
        missing = f"connect {np.count_nonzero(absent)} of {len(absent)} images"
        mapping.log.note(
            f"SIFT does not {missing if absent.any() else 'hold the poses of these images'}; "
            f"learned features often do where photographs are far apart: {INSTALL}"
        )
        return None
    learned, turns = _read_all(mapping, read_weights(path), absent)
    pairs = np.stack(np.triu_indices(len(absent), 1), axis=1)
    matches = _match_all(mapping, read_weights(matcher), learned, turns, pairs, absent)
    first = [len(features) for features in mapping.features]  # number of each first learned feature
    before = dict(zip(map(tuple, mapping.raw.pairs), mapping.raw.matches, strict=True))
    joined = [
        np.concatenate([before.get(tuple(pair), own[:0]), own + np.take(first, pair)])
        for pair, own in zip(pairs, matches, strict=True)
    ]
    more = mapping.replace(
        features=list(map(Features.join, mapping.features, learned)),
        raw=RawMatches(pairs, [each.astype(np.int32) for each in joined]),
        pairs=[],
    )
    if not mapping.photographs.are_lenses_known:
        return more
    on_pairs = mapping.log.follow_pairs("verifying")
    return more.replace(pairs=verify_matches(more.images, more.raw, mapping.options, on_pairs))


def _match_all(
    mapping: Mapping, weights: Weights, learned: list[Features], turns: list[int],
    pairs: np.ndarray, absent: np.ndarray,
) -> list[np.ndarray]:  # fmt: skip
    """Matches learned features of pairs (P, 2): by attention, which costs more, where it decides.

    Those are pairs of images that are left out with their likeliest partners, or all pairs of a few
    images. Others of each other's nearest features have enough.
    """
    matches = _match([features.descriptors for features in learned], pairs)
    counts = np.array([len(each) for each in matches])
    chosen = _choose_pairs(pairs, counts, absent | (len(absent) <= FEW_IMAGES))

    def match(index: int) -> np.ndarray:
        a, b = pairs[index]
        return match_by_attention(weights, learned[a], learned[b], (turns[a], turns[b]))

    log = mapping.log
    with ThreadPoolExecutor(mapping.options.threads or _core.num_threads()) as pool:
        for done, (index, found) in enumerate(zip(chosen, pool.map(match, chosen), strict=True)):
            matches[index] = found
            log.show("matching", done + 1, len(chosen), "learned features")
    return matches


def _choose_pairs(pairs: np.ndarray, counts: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Chooses pairs (P, 2) of each wanted image, from those of most matches (P,) on, in turns."""
    rank = np.full(len(pairs), len(wanted))
    for image in np.flatnonzero(wanted):
        own = np.flatnonzero((pairs == image).any(axis=1))
        own = own[np.argsort(-counts[own], kind="stable")]
        rank[own] = np.minimum(rank[own], np.arange(len(own)))
    most = min(FEW_IMAGES * (FEW_IMAGES - 1) // 2, int(np.count_nonzero(rank < len(wanted))))
    return np.sort(np.lexsort((-counts, rank))[:most])


def _read_all(
    mapping: Mapping, weights: Weights, absent: np.ndarray
) -> tuple[list[Features], list[int]]:
    """Finds the learned features of all images, each turned as matches best, and these turns."""
    photographs, options, log = mapping.photographs, mapping.options, mapping.log

    def read(image: int, turns: int) -> Features:
        try:
            return read_features(
                photographs.paths[image], photographs.cameras[image], options,
                photographs.masks[image],
                partial(detect_learned, weights, turns=turns, most=options.max_features),
            )  # fmt: skip
        except InputError:  # a note said so when SIFT looked at it
            return make_no_features()

    images = range(len(photographs))
    left_out = [int(image) for image in np.flatnonzero(absent)]
    turned = list(itertools.product(left_out, range(1, _TURNS)))
    with ThreadPoolExecutor(options.threads or _core.num_threads()) as pool:
        upright = list(pool.map(read, images, itertools.repeat(0)))
        log.show("learned", len(upright), len(upright) + len(turned), "upright")
        others = dict(zip(turned, pool.map(lambda key: read(*key), turned), strict=True))
    found, best = list(upright), [0] * len(upright)
    for image in left_out:
        tries = [upright[image], *(others[image, turns] for turns in range(1, _TURNS))]
        begin = max(0, min(image - FEW_IMAGES // 2, len(found) - FEW_IMAGES))
        end = min(begin + FEW_IMAGES, len(found))
        rest = [found[other] for other in range(begin, end) if other != image]
        counts = [_count_matches(features, rest) for features in tries]
        best[image] = int(np.argmax(counts))
        found[image] = tries[best[image]]
    log.show("learned", len(images) + len(turned), len(images) + len(turned), "")
    return found, best


def _count_matches(features: Features, others: list[Features]) -> int:
    """Counts the matches of an image's best features with those of the others."""
    descriptors = [each.descriptors[:MOST_MATCHED] for each in (features, *others)]
    pairs = np.array([(0, other) for other in range(1, len(descriptors))], np.int64)
    return sum(map(len, _match(descriptors, pairs, _NEAR)))


def _match(
    descriptors: list[np.ndarray], pairs: np.ndarray, distance: float = MAX_DISTANCE
) -> list[np.ndarray]:
    """Matches learned features of pairs (P, 2) of images that are each other's nearest.

    Those of neighbours are alike, so that Lowe's ratio says little.
    """
    return list(_core.match_pairs(descriptors, pairs, 1.0, distance))
