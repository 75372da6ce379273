"""Seconds that the stages of `gsut poses` take, told better as more is known of the images."""

from __future__ import annotations

import dataclasses

# On one core, fitted to twelve runs of six captures, of 30 to 70 images, 0.1 to 2 megapixels.
_FEATURES, _FEATURES_GROWTH = 0.27, 0.8  # an image of a megapixel, and a power of the megapixels
_PREVIEW, _MATCHING = 4.3e-4, 0.7e-9  # a pair; a pair's product of numbers of features
_VERIFYING = 2e-3  # a pair
_RANKING, _FIRST, _BEGINNING, _MODEL = 2.3, 2.8, 2.3, 1.7  # steps of the lens search
_ROLLING_TRIAL = 4.6  # of the lens search, with a rolling shutter: each from nothing
_MAPPING, _MAPPING_GROWTH = 5.1e-3, 0.68  # of a match, and a power of their number
_MAPPING_KNOWN = 0.8  # with a lens that is known
_ROLLING_TIMES = 2.9  # as long takes mapping with velocities
# Shares of mapping's seconds: asking a video for its shutter, adjusting with the one found, a rig.
_ASKING, _SHUTTER, _RIG = 0.1, 2.5, 0.6
# By what power of the megapixels, over the usual ones, lens search and mapping grow.
_LENS_GROWTH, _MAPPED_GROWTH, _USUAL = 0.2, 0.15, 0.4
_WRITING = {True: 0.033, False: 0.05}  # an image, by whether the lens is known
# Before features and pairs are known: features of a megapixel, pairs an image, matches a feature.
_DENSITY, _PAIRS, _MATCHES = 9000, 14, 0.09
_ALL_PAIRS, _PREVIEWED = 100, 28  # images of which all pairs are looked at; else so many an image
_PREVIEW_FEATURES, _MOST_FEATURES = 700, 4000


@dataclasses.dataclass(frozen=True)
class PosesWork:
    """What there is to do.

    Args:
        images: number of them.
        megapixels: of each, at the size at which features are sought.
        known: whether the lens is.
        rolling: whether the shutter is known to be. video: it is to be found out. lines: it was
            found that lines were read one after the other.
        rig: poses are on a rig.
        features: of an image, in the mean; pairs: compared in full; matches: of all pairs. None:
            not known yet.
    """

    images: int
    megapixels: float
    known: bool
    rolling: bool = False
    video: bool = False
    lines: bool = False
    rig: bool = False
    features: float | None = None
    pairs: int | None = None
    matches: int | None = None

    def seconds(self, threads: int) -> dict[str, float]:
        """The stages to come, in order, and the seconds of each on so many threads."""
        features = self.features or min(_MOST_FEATURES, _DENSITY * self.megapixels)
        looked_at = self.images * (self.images - 1) / 2
        if self.images > _ALL_PAIRS:
            looked_at = _PREVIEWED * self.images
        pairs = min(looked_at, _PAIRS * self.images) if self.pairs is None else self.pairs
        matches = _MATCHES * features * pairs if self.matches is None else self.matches
        size = self.megapixels / _USUAL
        mapping = _MAPPING * matches**_MAPPING_GROWTH * size**_MAPPED_GROWTH
        mapping *= (_ROLLING_TIMES if self.rolling else 1) * (_MAPPING_KNOWN if self.known else 1)
        parallel = {
            "features": self.images * _FEATURES * self.megapixels**_FEATURES_GROWTH,
            "preview": _PREVIEW * looked_at * min(1.0, features / _PREVIEW_FEATURES) ** 2,
            "matching": _MATCHING * pairs * features**2,
        }
        if self.known:
            parallel["verifying"] = _VERIFYING * pairs
        found = {name: value / max(1, threads) for name, value in parallel.items()}
        if not self.known:
            found["lens"] = LensSteps(self.rolling).total * size**_LENS_GROWTH
        found["mapping"] = mapping
        if self.video:
            found["shutter"] = mapping * (_SHUTTER if self.lines else _ASKING)
        if self.rig:
            found["rig"] = _RIG * mapping
        return found | {"writing": _WRITING[self.known] * self.images}


class LensSteps:
    """How far the search for a lens is, by its steps: what each takes, and which may come.

    Args:
        rolling: whether the shutter is.
    """

    def __init__(self, rolling: bool) -> None:
        trial, model = (_ROLLING_TRIAL,) * 2 if rolling else (_FIRST, _MODEL)
        # Of each step: its seconds, and how often it probably comes.
        self._seconds = {
            "first lenses": _RANKING, "first images": trial,
            "models": model, "more images": 0.0 if rolling else _BEGINNING,
        }  # fmt: skip
        self._to_come = {
            "first lenses": 1.0, "first images": 2.0, "more images": 1.0,
            "models": 3.0 if rolling else 4.0,
        }  # fmt: skip
        self._done = 0.0

    @property
    def part(self) -> float:
        """Of the ranking of lenses so much is done."""
        return 1.0 - self._to_come["first lenses"]

    @property
    def total(self) -> float:
        """Seconds of all steps, done and to come."""
        return self._done + sum(self._seconds[name] * n for name, n in self._to_come.items())

    def expect(self, step: str, times: float) -> None:
        """A step will come so often yet."""
        self._to_come[step] = times

    def done(self, step: str, part: float = 1.0) -> float:
        """A step, or a part of it, is done; returns the share of all seconds that is over."""
        self._to_come[step] = max(0.0, self._to_come[step] - part)
        self._done += part * self._seconds[step]
        return self._done / self.total
