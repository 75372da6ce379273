"""What a command shows of the time left, and on what share of its way that is right."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from gsut.run import StagedProgress, counted_down

_FACTOR, _SECONDS = 1.5, 1.0  # within which the time left is right
_FIRST = 10.0  # seconds that do not count
_GRID = 0.1  # seconds


class WatchedProgress(StagedProgress):
    """A bar that nobody sees, and what it shows.

    Attributes:
        shown: when, and the seconds left.
    """

    def __init__(
        self,
        expected: Mapping[str, float],
        enabled: bool = False,
        clock: Callable[[], float] = time.process_time,
    ) -> None:
        super().__init__(expected, enabled=False, clock=clock)
        self.shown: list[tuple[float, float]] = []
        self._clock = clock

    def show(self, share: float, text: str = "", left: float | None = None) -> None:
        """As a user sees it."""
        super().show(share, text, left)
        self.shown.append((self._clock(), self.left()))

    def shown_until(self, end: float) -> list[tuple[float, float]]:
        """What was shown, and at last nothing left."""
        return [*self.shown, (end, 0.0)]


def right_percent(shown: Sequence[tuple[float, float]], first: float = _FIRST) -> float:
    """Share in percent of the time, after the first seconds, that what is shown is right.

    Args:
        shown: when, and the seconds left; the last one is the end. Counted down until the next.
        first: seconds from the beginning that do not count.
    """
    moments, lefts = (np.array(column) for column in zip(*shown, strict=True))
    now = np.arange(moments[0] + first, moments[-1], _GRID)
    if not len(now):
        return 100.0
    last = np.searchsorted(moments, now, side="right") - 1
    left = np.array(
        [counted_down(lefts[i], t - moments[i]) for i, t in zip(last, now, strict=True)]
    )
    true = moments[-1] - now
    ratio = left / true
    right = (ratio < _FACTOR) & (ratio > 1 / _FACTOR) | (np.abs(left - true) < _SECONDS)
    return 100.0 * float(right.mean())
