"""Seconds that a training still takes, by what its steps have taken and how they will grow."""

from __future__ import annotations

import bisect
import dataclasses
import itertools
import time
from collections.abc import Callable

import numpy as np

from gsut.data import Scene
from gsut.optimize import compute_target_size
from gsut.run import TrainOptions

# Seconds on one core of a step: of any, of a megapixel, and of each Gaussian: how steps of
# unlike sizes compare, and what is left before any was made. Fox at 1/8 and 1/4 and sponza at 1/2,
# up to 100 000 Gaussians: within 20 %.
_STEP, _PIXELS, _GAUSSIANS = 0.0003, 0.085, 1.4e-7
_MEASURED = 0.9  # of a step at full size: a held-out view that is measured
_MOST_MEASURED = 8  # views each time
_AFTER, _AFTER_PIXELS = 1.0, 0.4  # at the end: of the report, and of a megapixel held out
_RECENT = 0.25  # share of the work so far by which the pace is judged
_TRUST = 1.0  # seconds of work that the pace before counts as


def megapixels_of(scene: Scene) -> float:
    """Millions of pixels of a scene's photographs, the mean of its cameras."""
    return sum(c.width * c.height for c in scene.cameras) / len(scene.cameras) / 1e6


def step_work(options: TrainOptions, first_count: int, megapixels: float) -> np.ndarray:
    """Seconds (S,) on one core that each step of a training takes, by a rule and no clock.

    Args:
        options, first_count, megapixels: see `TrainingTime`.
    """
    fraction = np.arange(1, options.steps + 1) / options.steps
    quarter, half = options.coarse_to_fine
    area = np.where(fraction <= quarter, 1 / 16, np.where(fraction <= half, 1 / 4, 1.0))
    counts = np.array([compute_target_size(options, max(1, first_count), f) for f in fraction])
    return _STEP + _PIXELS * megapixels * area + _GAUSSIANS * counts


class TrainingTime:
    """What is left of a training.

    Args:
        options: resolved, with the number of Gaussians that it will have.
        first_count: Gaussians at first.
        megapixels: of a training view at full size.
        held_out: number of held-out views.
        step: made before, by the run that this one goes on with.
        threads: that share the work.
        clock: seconds; for tests.
    """

    def __init__(
        self,
        options: TrainOptions,
        first_count: int,
        megapixels: float,
        held_out: int,
        step: int = 0,
        threads: int = 1,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        work = step_work(options, first_count, megapixels)
        if options.eval_every:
            views = min(_MOST_MEASURED, held_out)
            whole = dataclasses.replace(options, coarse_to_fine=(0.0, 0.0))
            full = step_work(whole, first_count, megapixels)
            is_due = np.arange(1, options.steps + 1) % options.eval_every == 0
            work += is_due * _MEASURED * views * full
        work /= max(1, threads)
        after = _AFTER + _AFTER_PIXELS * megapixels * held_out / max(1, threads)
        self._work = [0.0, *itertools.accumulate(work.tolist())]  # after so many steps
        self._all = self._work[-1] + after
        self._clock = clock
        self._done, self._at = [self._work[step]], [clock()]

    def left(self, step: int) -> float:
        """Seconds left after this step; each call tells the pace.

        Args:
            step: made, from 1.
        """
        done, now = self._work[min(step, len(self._work) - 1)], self._clock()
        self._done.append(done)
        self._at.append(now)
        first = self._done[0]
        recent = bisect.bisect_left(self._done, done - _RECENT * (done - first)) - 1
        recent = max(0, recent)
        overall = (now - self._at[0] + _TRUST) / (done - first + _TRUST)
        pace = (now - self._at[recent] + _TRUST * overall) / (done - self._done[recent] + _TRUST)
        return pace * (self._all - done)
