"""Ranks lenses by how well they explain pairs of images, before anything is reconstructed."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from gsut import _core
from gsut.lens import Camera
from gsut.sfm.matches import ENOUGH_MATCHES, RawMatches
from gsut.sfm.photographs import Features, PosesOptions

PAIRS = 24  # of images that lenses are compared by: more hardly change the order
_PAIRS_OF_AN_IMAGE = 2  # at most, so that the pairs spread over the images
ROUGH = 3.0  # factor on the largest error where a lens or a shutter is only nearly right
# Spread of a pair's displacements over the extent of its features, beyond which more is no better:
# pairs that move constrain a lens more than pairs with many matches.
_ENOUGH_SPREAD = 0.06


@dataclasses.dataclass(frozen=True)
class RankedLens:
    """A lens and the share (P,) of each pair's matches that agree with one pose through it."""

    camera: Camera
    shares: np.ndarray

    @property
    def share(self) -> float:
        """Returns the mean share."""
        return float(self.shares.mean()) if len(self.shares) else 0.0


class LensRanking:
    """Some pairs of images with depth, by which lenses are compared.

    A wrong lens bends epipolar lines: fewer of a pair's matches agree with one relative pose. The
    pose has five degrees of freedom and a pair hundreds of matches, so that this share is a fair
    prediction of matches that were not fitted.

    Args:
        features: of all images.
        raw: their matches.
        options: the largest error and the seed.
        error_factor: on the largest error; above 1 for rolling shutters.
    """

    def __init__(
        self,
        features: Sequence[Features],
        raw: RawMatches,
        options: PosesOptions,
        error_factor: float = 1.0,
    ) -> None:
        self._pixels = []
        for index in choose_informative_pairs(features, raw):
            ends = zip(raw.pairs[index], raw.matches[index][:ENOUGH_MATCHES].T, strict=True)
            self._pixels.append([features[image].pixels[rows] for image, rows in ends])
        self._error = error_factor * options.max_two_view_error / 1000
        self._seed = options.seed

    def measure_shares(self, camera: Camera) -> np.ndarray:
        """Returns the share (P,) of each pair's matches that agree through this lens."""
        bearings = [_core.ImageBearings(camera, own) for pair in self._pixels for own in pair]
        seen = [
            np.flatnonzero(one.valid & other.valid)[:, None].repeat(2, axis=1).astype(np.int32)
            for one, other in zip(bearings[::2], bearings[1::2], strict=True)
        ]
        error = self._error * float(np.hypot(camera.width, camera.height))
        ends = np.arange(len(bearings)).reshape(-1, 2)
        found = _core.verify_pairs(bearings, ends, seen, error, self._seed)
        return np.array(
            [each[0].sum() / len(pair[0]) for each, pair in zip(found, self._pixels, strict=True)]
        )

    def rank_lenses(
        self,
        likely: Sequence[Camera],
        others: Sequence[Camera],
        on_lens: Callable[[int, int], None],
    ) -> list[RankedLens]:
        """Ranks lenses, best first.

        Args:
            likely: lenses that are preferred where they score the same.
            others: further lenses.
            on_lens: called with (lenses done, lenses in all).
        """
        candidates = [*likely, *others]
        ranked = []
        for done, camera in enumerate(candidates, 1):
            ranked.append(RankedLens(camera, self.measure_shares(camera)))
            on_lens(done, len(candidates))
        return sorted(ranked, key=lambda lens: -lens.share)


def choose_informative_pairs(features: Sequence[Features], raw: RawMatches) -> np.ndarray:
    """Chooses pairs with many matches whose displacements differ, spread over the images."""
    scores = np.zeros(len(raw.pairs))
    for i, ((a, b), matches) in enumerate(zip(raw.pairs, raw.matches, strict=True)):
        if len(matches) < 2:
            continue
        moved = features[b].pixels[matches[:, 1]] - features[a].pixels[matches[:, 0]]
        spread = np.median(np.linalg.norm(moved - np.median(moved, axis=0), axis=1))
        extent = np.linalg.norm(np.ptp(features[a].pixels, axis=0))
        scores[i] = min(len(matches), ENOUGH_MATCHES) * min(
            spread / max(extent, 1e-9), _ENOUGH_SPREAD
        )
    used = np.zeros(len(features), np.int64)
    chosen: list[int] = []
    for i in np.argsort(-scores, kind="stable"):
        pair = raw.pairs[i]
        if scores[i] > 0 and used[pair].max() < _PAIRS_OF_AN_IMAGE:
            used[pair] += 1
            chosen.append(int(i))
        if len(chosen) == PAIRS:
            break
    return np.array(chosen, np.int64)
