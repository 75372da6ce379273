"""The pairs and matches that lenses are compared by: few, and those that say most."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from gsut.sfm.core.matching import PairMatches, RawMatches

# Matches, and radians of parallax, of a pair beyond which more do not count.
_ENOUGH_MATCHES = 200
_ENOUGH_PARALLAX = 0.2


def keep_most_distinct(pairs: Sequence[PairMatches], most: int) -> list[PairMatches]:
    """The pairs with their most distinct matches, which stand first."""
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
    """The pairs among `most` images that are best connected: by many matches, and by parallax.

    Neighbours in a video have most matches and tell least of the lens: a match counts by its
    pair's parallax.
    """
    strength: dict[int, dict[int, float]] = {}
    for pair in pairs:
        value = min(len(pair.matches), _ENOUGH_MATCHES) * min(pair.parallax, _ENOUGH_PARALLAX)
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


def only_pairs(raw: RawMatches, wanted: set[tuple[int, int]]) -> RawMatches:
    """The matches of these pairs of images."""
    kept = [i for i, (a, b) in enumerate(raw.pairs) if (int(a), int(b)) in wanted]
    return RawMatches(raw.pairs[kept], [raw.matches[i] for i in kept])
