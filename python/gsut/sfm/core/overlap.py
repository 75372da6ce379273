"""Explains why there is nothing to reconstruct, and what to do."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gsut._core import SolveError
from gsut.data import list_some
from gsut.sfm.core.features import Features
from gsut.sfm.core.matching import PairMatches

_FEW_IMAGES, _LITTLE_PARALLAX = 10, 1.5  # fewer images, and less parallax in degrees, are named
_POOR = 2  # of the faults that a verdict knows, the grave ones


def require_overlap(
    names: Sequence[str],
    features: Sequence[Features],
    pairs: Sequence[PairMatches],
    *,
    known: bool,
) -> None:
    """Refuses images that nothing can be made of.

    Args:
        names, features: of all images. pairs: verified matches.
        known: whether the lens was given.

    Raises:
        SolveError: no overlap, images all the same, or a camera that only turned; says which.
    """
    if not pairs:
        few = [n for n, f in zip(names, features, strict=True) if len(f) < 50]
        if len(few) * 2 > len(names):
            raise SolveError(
                f"{len(few)} of {len(names)} images have almost no features"
                f" ({list_some(few)}); photograph something with texture, in focus and well lit"
            )
        lens = ", or the lens is not theirs" if known else ""
        raise SolveError(
            f"no two of the {len(names)} images have matches that agree: they show different "
            f"things or overlap too little{lens}; give photographs of one place, each overlapping "
            "the next by more than half"
        )
    parallax = np.array([pair.parallax for pair in pairs])
    turned = np.array([pair.rotation_matches > 0.9 * len(pair.matches) for pair in pairs])
    if not turned.all():
        return
    if np.degrees(np.median(parallax)) < 0.02 or all(_same(pair) for pair in pairs):
        raise SolveError(
            "all images are the same: matched features do not move; give photographs from "
            "different places"
        )
    raise SolveError(
        f"in all {len(pairs)} overlapping pairs the camera only turned, so there is no depth; walk "
        "between the photographs instead of turning on the spot"
    )


def _same(pair: PairMatches) -> bool:
    """Whether neither turn nor shift is seen."""
    turn = np.arccos(np.clip((np.trace(pair.second_from_first[:3, :3]) - 1) / 2, -1, 1))
    return bool(np.degrees(turn) < 0.05)


def why_nothing(
    error: SolveError,
    features: Sequence[Features],
    pairs: Sequence[PairMatches],
    otherwise: str,
    *,
    turned: bool = False,
) -> SolveError:
    """An error of the mapper with what the images say of its cause, gravest first.

    Args:
        error: that nothing could be reconstructed.
        features: of all images. pairs: verified.
        otherwise: what else may help.
        turned: they show that the camera turned on the spot.
    """
    reasons = []
    if turned:
        reasons.append(
            "the camera only turned on the spot, so there is no depth: walk between the pictures"
        )
    faults = picture_faults(features, len(features))
    reasons += [f"{what}: {advice}" for level, what, advice in faults if level == _POOR]
    if len(features) < _FEW_IMAGES:
        reasons.append(f"{len(features)} images are few: take 20 or more")
    parallax = np.degrees(float(np.median([pair.parallax for pair in pairs] or [np.inf])))
    if parallax < _LITTLE_PARALLAX and not turned:
        reasons.append(
            f"the camera hardly moved between them ({parallax:.1f} degrees of parallax): walk "
            "sideways to what you photograph"
        )
    return SolveError("; ".join([str(error), *reasons, f"or {otherwise}"]))


_DARK, _BRIGHT = 25, 235  # mean grey values of features, beyond which pictures are badly exposed
_BAD = (0.25, 0.75)  # share of such pictures, above the first usable at most, above the second poor
_FEW_FEATURES = 500  # of a picture: blurred, dark or without texture


def picture_faults(features: Sequence[Features], total: int) -> list[tuple[int, str, str]]:
    """Exposure and blur: how bad (0 to 2), what, and what to do."""
    few = sum(len(f) < _FEW_FEATURES for f in features)
    grey = np.array([float(f.colors.mean()) for f in features if len(f)])
    dark, bright = int((grey < _DARK).sum()), int((grey > _BRIGHT).sum())
    return [
        (
            count_exceeded((dark + bright) / max(1, total), _BAD),
            f"{dark} of {total} images are too dark, {bright} too bright",
            "film with more light and a fixed exposure",
        ),
        (
            count_exceeded(few / max(1, total), _BAD),
            f"{few} of {total} images have few features: blurred, dark or without texture",
            "hold the camera still, film more slowly or with more light",
        ),
    ]


def count_exceeded(value: float, limits: tuple[float, float]) -> int:
    return int(value > limits[0]) + int(value > limits[1])
