"""What a run of `gsut poses` tells on its way, and what a user should know of its result."""

from __future__ import annotations

import dataclasses
import os
import time
from collections.abc import Callable
from typing import Any

from gsut.run import Stopwatch
from gsut.sfm.core.correspondences import OnProgress
from gsut.sfm.time_left import PosesWork, StepShares, mapping_share

# While images get a pose, a mapper's time is a power of their share. Of its other time so much is
# over after each of the steps that finish.
_GROWTH_POWER = 1.2
_FINISHED = {
    "settling": (0.10, 0.19, 0.29),
    "longer tracks": (0.33, 0.51),
    "final adjustment": (0.97,),
    "covariances": (1.0,),
}
# The same of poses that are adjusted, with a shutter or on a rig.
_ADJUSTED = {
    "adjustment": (0.12, 0.15, 0.18, 0.24, 0.30, 0.40, 0.44, 0.51, 0.54, 0.62, 0.66),
    "longer tracks": (0.34, 0.47),
    "final adjustment": (0.94,),
    "covariances": (1.0,),
}
_NOTHING_KNOWN = 0.4, 0.6, 0.0  # parts of a stage, of work that nothing is known of
_LEAST_PACE = 0.7  # of the stages before mapping: some may have been done by an earlier run
_PARTS = 1000  # of a stage that a mapper fills


class PosesLog:
    """What a run tells on its way: progress, notes, and the time of each stage."""

    def __init__(
        self,
        on_progress: OnProgress | None = None,
        notes_to: Callable[[str], None] | None = None,
        on_expected: Callable[[dict[str, float]], None] | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.notes: list[str] = []
        self.watch = Stopwatch()
        self._on_progress, self._notes_to = on_progress, notes_to
        self._on_expected = on_expected
        self._clock = clock
        self._began = clock()
        self._work: PosesWork | None = None
        self._threads = 1
        self._most: dict[str, int] = {}

    def note(self, *texts: str) -> None:
        for text in texts:
            self.notes.append(text)
            if self._notes_to is not None:
                self._notes_to(text)

    def show(self, stage: str, done: int, total: int, text: str) -> None:
        """Never goes back in a stage: a mapper that begins again is still in the same one."""
        if stage == "shutter" and stage not in self._most:
            self.learn(lines=True)
        self._most[stage] = max(done, self._most.get(stage, 0))
        if self._on_progress is not None:
            self._on_progress(stage, self._most[stage], total, text)

    def expect(self, work: PosesWork, threads: int) -> None:
        """Tells what the stages will take on so many threads; 0: all."""
        self._work, self._threads = work, threads or len(os.sched_getaffinity(0))
        self.learn()

    def learn(self, **known: Any) -> None:
        """The same, now that these fields of `PosesWork` are known."""
        if self._work is not None:
            self._work = dataclasses.replace(self._work, **known)
            if self._on_expected is not None:
                self._on_expected(self._work.seconds(self._threads))

    def on_pairs(self, stage: str) -> Callable[[int, int], None]:
        return lambda done, total: self.show(stage, done, total, f"{total} pairs")

    def on_readout(self, share: float, text: str) -> None:
        """Of finding a video's readout time so much is over."""
        self.show("shutter", round(_PARTS * self._spans("shutter")[0] * share), _PARTS, text)

    def _settled(self, begins: float, grown: float) -> None:
        """Mapping began then and grew until then: how long its adjustments took is known now.

        In seconds as those of the stages before it were expected in: a machine may be slower.
        """
        if self._work is None:
            return
        expected = self._work.seconds(self._threads)
        names = list(expected)
        before = sum(expected[name] for name in names[: names.index("mapping")])
        slower = max(_LEAST_PACE, (begins - self._began) / before)
        taken = (self._clock() - grown) / mapping_share(self._threads)
        self.learn(settling=taken / slower)

    def _spans(self, stage: str) -> tuple[float, float]:
        """Shares of a stage before its adjustments, and of these."""
        work = self._work
        before, during, after = _NOTHING_KNOWN if work is None else work.parts(stage)
        total = max(1e-9, before + during + after)
        return before / total, during / total

    def on_images(self, stage: str) -> Callable[[int, int, int, str], None]:
        """Of a mapper, or of poses that are adjusted, see `_FINISHED` and `_ADJUSTED`."""
        steps = StepShares(_ADJUSTED if stage in ("shutter", "rig") else _FINISHED)
        before, during = self._spans(stage)
        begins = grown = self._clock()

        def show(done: int, total: int, points: int, step: str) -> None:
            nonlocal grown
            finished = steps.after(step)
            if finished is None:
                grown = self._clock()
                share = before * (done / max(1, total)) ** _GROWTH_POWER
            else:
                share = before + during * finished
            if finished == 1.0 and stage == "mapping":
                self._settled(begins, grown)
            words = f"{done} of {total} images, {points:,} points"
            self.show(stage, round(_PARTS * share), _PARTS, words)

        return show
