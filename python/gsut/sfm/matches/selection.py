"""Selects few pairs and matches for quick trials: those that say most."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from gsut.sfm.matches.matching import PairMatches, RawMatches

FEW_IMAGES = 12  # up to which each two of them are looked at, and more are suggested
ENOUGH_MATCHES = 150  # of a pair, the most distinct: more say nothing more of it, and take time
_ENOUGH_PARALLAX = 0.2  # radians, beyond which more does not count


def keep_most_distinct(
    pairs: Sequence[PairMatches], most: int = ENOUGH_MATCHES
) -> list[PairMatches]:
    """Keeps at most `most` matches of each pair, the most distinct, which stand first."""
    return [
        pair
        if len(pair.matches) <= most
        else dataclasses.replace(
            pair,
            matches=pair.matches[:most],
            rotation_matches=round(pair.rotation_matches * most / len(pair.matches)),
        )
        for pair in pairs
    ]


def choose_connected_pairs(pairs: Sequence[PairMatches], most: int) -> list[PairMatches]:
    """Chooses the pairs among the `most` images best connected by matches and parallax.

    Neighbours in a video have most matches but constrain the lens least, so a match counts by its
    pair's parallax.
    """
    strength: dict[int, dict[int, float]] = {}
    for pair in pairs:
        value = min(len(pair.matches), ENOUGH_MATCHES) * min(pair.parallax, _ENOUGH_PARALLAX)
        strength.setdefault(pair.first, {})[pair.second] = value
        strength.setdefault(pair.second, {})[pair.first] = value
    if len(strength) <= most:
        return list(pairs)
    start = max(pairs, key=lambda pair: strength[pair.first][pair.second])
    chosen = {start.first, start.second}
    while len(chosen) < most:
        links = {
            image: sum(value for other, value in found.items() if other in chosen)
            for image, found in strength.items()
            if image not in chosen
        }
        chosen.add(max(links, key=lambda image: links[image]))
    return [pair for pair in pairs if pair.first in chosen and pair.second in chosen]


def are_connected(pairs: Sequence[PairMatches], num_images: int) -> bool:
    """Returns whether pairs connect each image with all others, directly or through some."""
    return len(np.unique(group_images(pairs, num_images))) == 1


def group_images(pairs: Sequence[PairMatches], num_images: int) -> np.ndarray:
    """Returns (N,) numbers of groups: pairs connect the images of one, directly or through some."""
    group = np.arange(num_images)
    for pair in pairs:
        group[group == group[pair.second]] = group[pair.first]
    return group


def select_pairs(raw: RawMatches, wanted: set[tuple[int, int]]) -> RawMatches:
    """Keeps the matches of these pairs of images."""
    kept = [i for i, (a, b) in enumerate(raw.pairs) if (int(a), int(b)) in wanted]
    return RawMatches(raw.pairs[kept], [raw.matches[i] for i in kept])


def select_verified_pairs(pairs: Sequence[PairMatches], chosen: np.ndarray) -> list[PairMatches]:
    """Keeps the pairs of the chosen images, which are then counted from 0."""
    place = {int(image): index for index, image in enumerate(chosen)}
    return [
        dataclasses.replace(pair, first=place[pair.first], second=place[pair.second])
        for pair in pairs
        if pair.first in place and pair.second in place
    ]
