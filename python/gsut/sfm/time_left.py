"""Seconds that the stages of `gsut poses` take, told better as more is known of the images."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

# On one core, fitted to runs of four captures of 30 to 70 images and of films of 100 and 300.
_FEATURES, _FEATURES_GROWTH = 0.31, 0.8  # an image of a megapixel, and a power of the megapixels
_PREVIEW, _MATCHING = 5.5e-4, 0.8e-9  # a pair; a pair's product of numbers of features
# A pair that is verified, and at how many matches it takes twice as long, as fewer agree by chance.
_VERIFYING, _FEW_MATCHES, _FEW_POWER = 1e-3, 150, 3
_RANKING, _FIRST, _BEGINNING, _MODEL = 2.5, 1.7, 2.2, 1.2  # steps of the lens search
_ROLLING_TRIAL = 3.5  # of the lens search, with a rolling shutter: each from nothing
_LENS_GROWTH, _USUAL = 0.2, 0.2  # of the lens search, power of the megapixels over the usual ones
# Mapping, of the matches times the images, and a power of it: until all images have a pose, and the
# adjustments at the end.
_GROWING, _GROWING_POWER = 1.9e-6, 0.873
_SETTLING, _SETTLING_POWER = 8.5e-4, 0.545
_FEATURES_OF_IMAGE, _FEATURES_POWER = 1300, 0.65  # the latter times as many features
_SETTLING_KNOWN = 0.7  # with a lens that is known
_ROLLING_GROWING, _ROLLING_SETTLING = 6.0, 2.6  # as long they take with velocities
_ZOOMS = 1.5e-4  # of the number of images squared
_COVARIANCE = 0.06  # of a lens, of the adjustments
# A video's shutter: an image whose motion is found; the readout; and, of the adjustments at the end
# of mapping, those with it, and the covariance of a lens then.
_MOTION, _READOUT, _WITH_SHUTTER, _COVARIANCE_THEN = 0.012, 4.2, 2.0, 0.3
_RIG = 0.6  # of mapping
_PARALLEL = 0.8  # share of mapping that all threads do
_WRITING, _WRITING_IMAGE = 0.5, 0.008
# Before features and pairs are known: features of a megapixel, pairs an image, matches a feature.
_DENSITY, _PAIRS, _MATCHES = 9000, 14, 0.09
_ALL_PAIRS, _PREVIEWED = 100, 28  # images of which all pairs are looked at; else so many an image
_PREVIEW_FEATURES, _MOST_FEATURES = 700, 4000


def mapping_share(threads: int) -> float:
    """Of the seconds of one thread, that mapping takes on so many."""
    return 1 - _PARALLEL + _PARALLEL / max(1, threads)


def verifying_seconds(pairs: float, matches: float) -> float:
    """Of pairs with so many matches in all, on one thread."""
    few = _FEW_MATCHES * pairs / max(1.0, matches)
    return _VERIFYING * pairs * min(10.0, 1 + few**_FEW_POWER)


@dataclasses.dataclass(frozen=True)
class PosesWork:
    """What there is to do.

    Args:
        images: number of them.
        megapixels: of each, at the size at which features are sought.
        known: whether the lens is.
        rolling: whether the shutter is known to be. video: it is to be found out. lines: lines were
            read one after the other, as far as is known.
        rig: poses are on a rig.
        features: of an image, in the mean; pairs: compared in full; matches: of all pairs; None:
            not known yet. settling: seconds of one thread that the adjustments at the end of
            mapping took, or None.
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
    settling: float | None = None

    def seconds(self, threads: int) -> dict[str, float]:
        """The stages to come, in order, and the seconds of each on so many threads."""
        features, looked_at, pairs, matches = self._sizes()
        parallel = {
            "features": self.images * _FEATURES * self.megapixels**_FEATURES_GROWTH,
            "preview": _PREVIEW * looked_at * min(1.0, features / _PREVIEW_FEATURES) ** 2,
            "matching": _MATCHING * pairs * features**2,
        }
        verifying = verifying_seconds(pairs, matches)
        if self.known:
            parallel["verifying"] = verifying
        found = {name: value / max(1, threads) for name, value in parallel.items()}
        if not self.known:
            size = (self.megapixels / _USUAL) ** _LENS_GROWTH
            found["lens"] = LensSteps(self.rolling, verifying / size).total * size
        share = mapping_share(threads)
        found["mapping"] = share * sum(self.parts("mapping"))
        if self.rig:
            found["rig"] = share * sum(self.parts("rig"))
        if self.video:
            found["shutter"] = share * sum(self.parts("shutter"))
        return found | {"writing": _WRITING + _WRITING_IMAGE * self.images}

    def parts(self, stage: str) -> tuple[float, float, float]:
        """Seconds of one thread: before the adjustments of a stage, of them, and after them."""
        features, _, _, matches = self._sizes()
        together = max(1.0, matches * self.images)
        growing = _GROWING * together**_GROWING_POWER
        settling = _SETTLING * together**_SETTLING_POWER * (_SETTLING_KNOWN if self.known else 1)
        settling *= (features / _FEATURES_OF_IMAGE) ** _FEATURES_POWER
        if self.rolling:
            growing, settling = _ROLLING_GROWING * growing, _ROLLING_SETTLING * settling
        if self.settling is not None:
            settling = self.settling
        if stage == "rig":
            return 0.0, _RIG * (growing + settling), 0.0
        if stage == "shutter":
            if not self.lines:
                return 0.0, 0.0, 0.0
            after = 0.0 if self.known else _COVARIANCE_THEN * settling
            return _READOUT, _WITH_SHUTTER * settling, after
        after = _ZOOMS * self.images**2 + (_MOTION * self.images if self.video else 0.0)
        if not (self.known or self.video):
            after += _COVARIANCE * settling
        return growing, settling, after

    def _sizes(self) -> tuple[float, float, float, float]:
        """Features of an image, pairs looked at and compared, and matches, as far as is known."""
        features = self.features or min(_MOST_FEATURES, _DENSITY * self.megapixels)
        looked_at = self.images * (self.images - 1) / 2
        if self.images > _ALL_PAIRS:
            looked_at = _PREVIEWED * self.images
        pairs = min(looked_at, _PAIRS * self.images) if self.pairs is None else self.pairs
        matches = _MATCHES * features * pairs if self.matches is None else self.matches
        return features, looked_at, pairs, matches


class LensSteps:
    """How far the search for a lens is, by its steps: what each takes, and which may come.

    Args:
        rolling: whether the shutter is.
        verifying: seconds that it takes to verify all pairs.
    """

    def __init__(self, rolling: bool, verifying: float = 0.0) -> None:
        trial, model = (_ROLLING_TRIAL,) * 2 if rolling else (_FIRST, _MODEL)
        # Of each step: its seconds, and how often it probably comes.
        self._seconds = {
            "first lenses": _RANKING, "pairs": verifying, "first images": trial,
            "models": model, "more images": 0.0 if rolling else _BEGINNING,
        }  # fmt: skip
        self._to_come = {
            "first lenses": 1.0, "pairs": 1.5, "first images": 1.5, "more images": 1.0,
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


class StepShares:
    """How far adjustments are, by their steps.

    Args:
        shares: that are over after the steps of each kind, in order; some may be left out.
    """

    def __init__(self, shares: Mapping[str, Sequence[float]]) -> None:
        self._shares, self._reached = shares, 0.0

    def after(self, step: str) -> float | None:
        """The share that is over after one more step of a kind; None: it is no such step."""
        if step not in self._shares:
            return None
        later = [share for share in self._shares[step] if share > self._reached]
        self._reached = min(later, default=self._reached)
        return self._reached
