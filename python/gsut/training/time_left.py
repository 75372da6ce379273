"""Estimates how long a training still takes, from the pace of its latest steps."""

from __future__ import annotations

import bisect
import itertools
import time
from collections.abc import Callable

import numpy as np

from gsut.optimize import compute_target_size
from gsut.run.options import Recipe


class Pace:
    """The time left of a training, by how fast the later half of the work done went.

    A step's work is the share of the pixels that it draws and the share of the Gaussians that it
    has, of those at the end: their cost differs between machines and scenes, and the pace follows.

    Args:
        recipe: of the training.
        steps: number of them.
        first, most: number of Gaussians at first and at the end.
        step: steps that an earlier run has made.
        clock: seconds; for tests.
    """

    def __init__(
        self,
        recipe: Recipe,
        steps: int,
        first: int,
        most: int,
        step: int = 0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        fraction = np.arange(1, steps + 1) / steps
        quarter, half = recipe.coarse_to_fine
        pixels = np.where(fraction <= quarter, 1 / 16, np.where(fraction <= half, 1 / 4, 1.0))
        first, overgrowth = max(1, first), recipe.overgrowth
        counts = [compute_target_size(most, first, at, overgrowth) / most for at in fraction]
        self._done = [0.0, *itertools.accumulate((pixels + counts).tolist())]
        self._clock = clock
        self._work, self._seconds = [self._done[step]], [clock()]  # at each report

    def estimate_left(self, step: int) -> float | None:
        """Returns the seconds left after a step, counted from 1; None before the first one."""
        done, now = self._done[min(step, len(self._done) - 1)], self._clock()
        half = bisect.bisect_left(self._work, (self._work[0] + done) / 2, hi=len(self._work) - 1)
        if done <= self._work[half]:
            return None
        pace = (now - self._seconds[half]) / (done - self._work[half])
        if done > self._work[-1]:
            self._work.append(done)
            self._seconds.append(now)
        return pace * (self._done[-1] - done)
