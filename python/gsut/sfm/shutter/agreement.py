"""Finds the order in which the lines of a video are read by the matches that agree with each."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence

import numpy as np

from gsut._core import Shutter, SolveError
from gsut.sfm.matches import PairMatches
from gsut.sfm.solution import Solution, measure_agreement
from gsut.significance import convert_to_normal

_GROUPS = 8  # of successive images, taken to err independently
_SURE = 3.0  # standard deviations, as rare as in a normal law, between an order and its reverse

# Adjusts some images with lines that are read in this order; None: all at once.
Adjust = Callable[[Shutter | None], Solution]


@dataclasses.dataclass(frozen=True)
class AgreeingOrder:
    """The order of the lines that most matches agree with.

    Args:
        shutter: the order.
        sigmas: standard deviations, as of a normal law, from the reverse.
        share: of the readout time of the trial, where a parabola through the numbers of agreeing
            matches of both orders and of none has its top; at most 1.
        matches: that agree.
    """

    shutter: Shutter
    sigmas: float
    share: float
    matches: float


def find_agreeing_order(
    adjust: Adjust, pairs: Sequence[PairMatches], ways: Sequence[tuple[Shutter, Shutter]]
) -> AgreeingOrder | None:
    """Finds the order of the lines that more matches agree with than with its reverse.

    Poses without a rolling shutter take up most of what one does, and little of it is left in their
    residuals. Poses that are adjusted with a wrong order lose matches, and gain some with the right
    one.

    Args:
        adjust: with a usual readout time.
        pairs: matches that are counted.
        ways: each order to try, and its reverse.

    Returns:
        None where no order is clear.
    """
    try:
        still = _count_agreeing(adjust(None), pairs)
        orders = []
        for way in ways:
            one, other = (_count_agreeing(adjust(each), pairs) for each in way)
            orders.append(_compare_orders(way, still, one, other))
    except SolveError:
        return None
    sure = [order for order in orders if order.sigmas > _SURE]
    return max(sure, key=lambda each: each.matches, default=None)


def _count_agreeing(solution: Solution, pairs: Sequence[PairMatches]) -> np.ndarray:
    """Counts the matches that observe one point, (G,) by groups of successive images."""
    images = np.unique([(pair.first, pair.second) for pair in pairs])
    group = np.zeros(len(solution.names), np.int64)
    group[images] = np.arange(len(images)) * _GROUPS // len(images)
    known = [p for p in pairs if solution.registered[p.first] and solution.registered[p.second]]
    counts = np.zeros(_GROUPS)
    for pair, count in zip(known, measure_agreement(solution, known).together, strict=True):
        np.add.at(counts, group[[pair.first, pair.second]], 0.5 * count)
    return counts


def _compare_orders(
    way: tuple[Shutter, Shutter], still: np.ndarray, one: np.ndarray, other: np.ndarray
) -> AgreeingOrder:
    """Compares an order with its reverse; the better one is returned.

    Args:
        way: both.
        still, one, other: see `_count_agreeing`: of a global shutter, and of both.
    """
    difference = one - other
    better, worse = max(one.sum(), other.sum()), min(one.sum(), other.sum())
    spread = math.sqrt(_GROUPS) * float(np.std(difference, ddof=1))
    sigmas = convert_to_normal(abs(difference.sum()) / max(spread, 1e-9), _GROUPS - 1)
    bend = 2 * float(still.sum()) - better - worse
    share = 0.5 * (better - worse) / bend if bend > 0 else 1.0
    return AgreeingOrder(
        way[int(difference.sum() < 0)], float(sigmas), min(share, 1.0), float(better)
    )
