"""Decides which of two structures explains the same matches better, beyond chance.

A structure is any set of poses, lenses and shutters. Its score is the robust log-likelihood of
matches: an error is normal with the noise of the features, or the match is wrong and lies anywhere.
Free parameters cost half the logarithm of the observations each (Schwarz, "Estimating the dimension
of a model", 1978). Matches of an image err together, so that chance is how much the gains of images
differ.
"""

from __future__ import annotations

import dataclasses
import math
import statistics
from collections.abc import Callable

import numpy as np

from gsut.significance import convert_to_normal

# Standard deviations of its gain, as rare as in a normal law, from which a rival wins: the one
# limit of all choices.
SURE = 3.0
# Share of the images or points of a solution, or of the matches of a lens, that another one in its
# place must have.
KEPT = 0.9
_ROUNDS = 20  # of expectation and maximization, which settle in about ten
# Standard deviation of a normal law, in median absolute deviations: these hold a half of it.
MEDIAN_DEVIATION = 1 / statistics.NormalDist().inv_cdf(0.75)
LEAST_NOISE = 0.01  # pixels: no feature is found better


@dataclasses.dataclass(frozen=True)
class Matches:
    """Matches by which structures are compared: verified, but inliers of none of them chosen.

    Args:
        images: (M, 2) numbers of the two images of each match.
        extent: pixels over which wrong matches spread, such as the diagonal of the images.
    """

    images: np.ndarray
    extent: float


@dataclasses.dataclass(frozen=True)
class Structure:
    """How well a structure explains matches.

    Args:
        errors: (M,) pixels by which the rays of each match miss each other; NaN: an image has no
            pose, or the lens no ray.
        free: number of its free parameters.
        prior: logarithm of the density that is known beforehand of what it estimates; minus
            infinity: impossible.
    """

    errors: np.ndarray
    free: float = 0.0
    prior: float = 0.0


@dataclasses.dataclass(frozen=True)
class Preference:
    """Which of two structures explains matches better.

    Args:
        is_rival: the rival does, beyond chance, and in most images that it touches.
        gain: of the rival, in nats, its free parameters paid for.
        sigma: standard deviation of the gain over images.
        share: of the images that the rival touches, those that gain.
    """

    is_rival: bool
    gain: float
    sigma: float
    share: float


def prefer(current: Structure, rival: Structure, matches: Matches) -> Preference:
    """Decides whether a rival explains the same matches better than the current structure."""
    noise, fitting = estimate_noise(np.stack([current.errors, rival.errors]), matches.extent)
    scores = [
        score_errors(each.errors, noise, fitting, matches.extent) for each in (current, rival)
    ]
    gains = scores[1] - scores[0]
    observations = max(2.0, fitting * len(gains))
    cost = 0.5 * (rival.free - current.free) * math.log(observations)
    by_matches = float(gains.sum()) - cost
    gain = by_matches + _compare_priors(current, rival)
    by_image, sigma = _measure_spread(gains, matches.images)
    share = float(np.mean(by_image > 0)) if len(by_image) else 0.0
    rare = float(convert_to_normal(gain / sigma, max(1, len(by_image) - 1)))
    # Where matches speak against the rival, what else is known decides.
    is_sure = rare > SURE and (share > 0.5 or by_matches < 0)
    wins = gain > 0 and (is_sure or math.isinf(gain))
    return Preference(wins, gain, sigma, share)


def estimate_noise(errors: np.ndarray, extent: float) -> tuple[float, float]:
    """Estimates the standard deviation of right matches' errors in pixels, and the share of these.

    Errors of right matches are normal, those of wrong ones uniform.

    Args:
        errors: of any shape, pixels; those that are not finite count as wrong.
        extent: see `Matches`.
    """
    known = errors[np.isfinite(errors)]
    noise = max(float(np.median(known)), LEAST_NOISE) if len(known) else LEAST_NOISE

    def update(weights: np.ndarray) -> None:
        nonlocal noise
        noise = max(math.sqrt(weights @ known**2), LEAST_NOISE)

    share = estimate_share(lambda: _evaluate_normal(known, noise), update, errors.size, extent)
    return noise, share


def estimate_share(
    evaluate: Callable[[], np.ndarray],
    update: Callable[[np.ndarray], None],
    count: int,
    extent: float,
) -> float:
    """Estimates the share of right matches, and their law, by expectation and maximization.

    Args:
        evaluate: returns the density (M,) of right matches by the law.
        update: fits the law to the weights (M,) of right matches, whose sum is 1.
        count: number of all matches, with those that have no error.
        extent: length or area over which wrong matches spread.
    """
    share = 0.5
    for _ in range(_ROUNDS):
        density = share * evaluate()
        right = density / (density + (1 - share) / extent)
        total = float(right.sum())
        update(right / max(total, 1.0))
        share = total / max(1, count)
    return share


def score_errors(errors: np.ndarray, noise: float, fitting: float, extent: float) -> np.ndarray:
    """Returns the logarithm of each error's density over that of a wrong match, in nats.

    Args:
        errors: pixels; those that are not finite are wrong matches.
        noise, fitting: see `estimate_noise`.
        extent: see `Matches`.
    """
    right = fitting * _evaluate_normal(np.where(np.isfinite(errors), errors, np.inf), noise)
    return np.log(1 - fitting + right * extent)


def _evaluate_normal(errors: np.ndarray, noise: float) -> np.ndarray:
    """Returns the density of absolute errors under a normal law."""
    return math.sqrt(2 / math.pi) / noise * np.exp(-0.5 * (errors / noise) ** 2)


def _compare_priors(current: Structure, rival: Structure) -> float:
    """Returns the logarithm of the rival's prior density over the current structure's."""
    if current.prior == rival.prior:  # also where both are impossible
        return 0.0
    return rival.prior - current.prior


def _measure_spread(gains: np.ndarray, images: np.ndarray) -> tuple[np.ndarray, float]:
    """Measures the gain of each image that changes, and the standard deviation of their sum.

    The gain of a match is shared by its two images, and images with more matches are expected to
    gain more. The spread is that of the median, so that what mends a few images much does not look
    like chance. An image changes if it gains or loses a nat: less is no evidence, so that no gain
    is known better than to a nat for each image.

    Args:
        gains: (M,) of the matches.
        images: (M, 2) of each.
    """
    count = int(images.max(initial=-1)) + 1
    by_image = np.bincount(images.ravel(), np.repeat(0.5 * gains, 2), count)
    matches = np.bincount(images.ravel(), minlength=count)
    touched = np.abs(by_image) > 1
    by_image, matches = by_image[touched], matches[touched]
    if len(by_image) < 2:
        return by_image, math.inf
    rates = by_image * (matches.mean() / matches)
    spread = MEDIAN_DEVIATION * float(np.median(np.abs(rates - np.median(rates))))
    return by_image, math.sqrt(len(by_image) * (spread**2 + 1))
