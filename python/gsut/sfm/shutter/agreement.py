"""Finds the order in which the lines of a video are read by the matches that each explains."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from gsut._core import Shutter
from gsut.sfm.matches import PairMatches
from gsut.sfm.photographs import Features
from gsut.sfm.solution import Solution, compare_solutions

_BACKWARDS = {"top_to_bottom": "bottom_to_top", "left_to_right": "right_to_left"}


def reverse_lines(shutter: Shutter) -> Shutter:
    """Returns the shutter that reads the same lines backwards."""
    backwards = _BACKWARDS | {there: here for here, there in _BACKWARDS.items()}
    return Shutter(backwards[shutter.direction])


def find_better_order(
    adjust: Callable[[Shutter | None], Solution],
    features: Sequence[Features],
    pairs: Sequence[PairMatches],
    ways: Sequence[Shutter],
) -> tuple[Shutter, float] | None:
    """Finds the order of the lines that explains matches better than the reverse.

    Poses without a rolling shutter take up most of what one does, and little of it is left in their
    residuals. Poses that are adjusted with a wrong order lose matches, and gain some with the right
    one.

    Args:
        adjust: adjusts some images with lines read in this order, for a usual time; None: at once.
        features: of all images.
        pairs: whose matches count.
        ways: orders to try, each beside its reverse.

    Returns:
        The order, and the share of the trial's readout time where a parabola through the scores of
        both orders and of none has its top, at most 1; None where none is better beyond chance.

    Raises:
        SolveError: too few points agree with an order.
    """
    still, best, most = adjust(None), None, -math.inf
    for way in ways:
        orders = (way, reverse_lines(way))
        moved = [adjust(order) for order in orders]
        gains = [compare_solutions(still, each, features, pairs).gain for each in moved]
        better, worse = (0, 1) if gains[0] > gains[1] else (1, 0)
        found = compare_solutions(moved[worse], moved[better], features, pairs)
        if found.is_rival and gains[better] > most:
            bend, most = -sum(gains), gains[better]
            share = 0.5 * (gains[better] - gains[worse]) / bend if bend > 0 else 1.0
            best = orders[better], min(share, 1.0)
    return best
