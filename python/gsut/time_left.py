"""Predicts how long poses and trainings take, from six rates; a progress bar corrects the pace."""

from __future__ import annotations

import bisect
import dataclasses
import itertools
import time
from collections.abc import Callable, Sequence

import numpy as np

# Seconds on one core of a machine of 2024; another machine scales all of them alike.
FEATURES = 0.3  # of finding the features of an image of one megapixel: SIFT
PAIR = 0.015  # of matching and verifying two images of some thousand features
MAPPING = 0.25  # of registering an image and adjusting it with the others
STEP = 0.00057  # of a training step of any size
PIXELS = 0.1615  # of a training step for each megapixel drawn
GAUSSIANS = 2.66e-7  # of a training step for each Gaussian


@dataclasses.dataclass(frozen=True)
class PosesWork:
    """What a run of `gsut poses` has to do.

    Args:
        images: number of images.
        megapixels: of each image, at the size at which features are found.
        pairs: of images that are compared.
        stages: further stages, each about as long as mapping: "lens", "rig", "shutter".
    """

    images: int
    megapixels: float
    pairs: float
    stages: tuple[str, ...] = ()

    def predict_seconds(self, threads: int) -> dict[str, float]:
        """Returns the seconds of each stage in order; mapping is taken to run on one core."""
        mapping = MAPPING * self.images
        seconds = {
            "features": FEATURES * self.megapixels * self.images / max(1, threads),
            "matching": PAIR * self.pairs / max(1, threads),
            "lens": mapping,
            "mapping": mapping,
            "rig": mapping,
            "shutter": mapping,
            "writing": 1.0,
        }
        optional = {"lens", "rig", "shutter"} - set(self.stages)
        return {name: value for name, value in seconds.items() if name not in optional}


def predict_steps(megapixels: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Predicts the seconds (S,) on one core of training steps, by a rule and without a clock.

    Args:
        megapixels: (S,) drawn in each step.
        counts: (S,) Gaussians in each step.
    """
    return STEP + PIXELS * megapixels + GAUSSIANS * counts


class Pace:
    """The time left of steps whose durations were predicted, by how fast the latest went.

    The pace is that of the later half of the work done: how far a prediction is off changes with
    the resolution and the number of Gaussians.

    Args:
        seconds: predicted for each step, in order.
        after: seconds predicted for what follows the last step.
        step: steps that an earlier run has made.
        clock: seconds; for tests.
    """

    def __init__(
        self,
        seconds: Sequence[float],
        after: float = 0.0,
        step: int = 0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._done = [0.0, *itertools.accumulate(seconds)]
        self._all = self._done[-1] + after
        self._clock = clock
        self._work, self._seconds = [self._done[step]], [clock()]  # at each report

    def predict_left(self, step: int) -> float:
        """Returns the seconds left after a step, counted from 1."""
        done = self._done[min(step, len(self._done) - 1)]
        now = self._clock()
        half = bisect.bisect_left(self._work, (self._work[0] + done) / 2, hi=len(self._work) - 1)
        # One second at the predicted pace keeps the first steps from deciding it.
        pace = (now - self._seconds[half] + 1.0) / (done - self._work[half] + 1.0)
        if done > self._work[-1]:
            self._work.append(done)
            self._seconds.append(now)
        return pace * (self._all - done)
