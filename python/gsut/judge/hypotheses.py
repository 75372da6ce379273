"""Tries hypotheses about what is given: a table of rows over one rating."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Sequence
from typing import Generic, TypeVar

import numpy as np

_FINEST = 1 / 16  # of the first step: where a climb ends

Given = TypeVar("Given")
Numbers = Sequence[float] | np.ndarray
# Scores of a dataset (G,): nats a match, of each group of images.
Rate = Callable[[Given], np.ndarray]


@dataclasses.dataclass(frozen=True)
class Variant(Generic[Given]):
    """What a hypothesis supposes.

    Args:
        words, edit: fill the braces of the hypothesis's sentence and cure.
        data: the dataset, if it is so.
    """

    words: str
    edit: str
    data: Given


@dataclasses.dataclass(frozen=True)
class Hypothesis(Generic[Given]):
    """One way in which a dataset may be wrong.

    Args:
        sentence: completes "the photographs fit ...".
        cure: the edit that mends the data.
        subject: "poses" or "lens".
        suppose: yields what may have been meant; may climb by the rating that it gets.
        is_gross: if it is so, the given dataset explains little.
        is_everywhere: if it is so, every group of images that it touches fits better by it; where
            some do not, it must explain much.
        free: number of the numbers that it estimates.
    """

    sentence: str
    cure: str
    subject: str
    suppose: Callable[[Given, Rate[Given]], Iterable[Variant[Given]]]
    is_gross: bool = False
    is_everywhere: bool = False
    free: int = 0


def climb(
    suppose: Callable[[np.ndarray], Given | None],
    rate: Rate[Given],
    starts: Iterable[Numbers],
    steps: Numbers,
) -> np.ndarray:
    """Searches the numbers with which a dataset scores best, by ever smaller steps.

    Args:
        suppose: makes the dataset of numbers (N,); None: there is none.
        rate: scores it.
        starts: the best of them is where the search starts.
        steps: (N,) the first steps.
    """

    def rate_numbers(x: np.ndarray) -> float:
        data = suppose(x)
        return -np.inf if data is None else float(np.mean(rate(data)))

    tried = [(rate_numbers(np.array(start, float)), tuple(start)) for start in starts]
    best, x = max(tried)[0], np.array(max(tried)[1], float)
    size = 1.0
    while size >= _FINEST:
        before = best
        for axis in range(len(x)):
            for sign in (-size, size):
                trial = x.copy()
                trial[axis] += sign * steps[axis]
                found = rate_numbers(trial)
                if found > best:
                    best, x = found, trial
        if best == before:
            size /= 2
    return x


def find_best_variants(
    hypotheses: Sequence[Hypothesis[Given]], given: Given, rate: Rate[Given], is_poor: bool
) -> list[tuple[Hypothesis[Given], Variant[Given]]]:
    """Finds the best variant of each hypothesis that scores better than what is given.

    Args:
        hypotheses: the rows.
        given: the dataset.
        rate: scores a dataset.
        is_poor: the given dataset explains so little that gross mistakes are possible.
    """
    base, found = float(np.mean(rate(given))), []
    for hypothesis in hypotheses:
        if is_poor or not hypothesis.is_gross:
            rated = [
                (float(np.mean(rate(variant.data))), variant)
                for variant in hypothesis.suppose(given, rate)
            ]
            value, best = max(rated, key=lambda each: each[0], default=(base, None))
            if best is not None and value > base:
                found.append((value, hypothesis, best))
    found.sort(key=lambda each: -each[0])
    return [(hypothesis, best) for _, hypothesis, best in found]
