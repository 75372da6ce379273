"""What a command shows of the time left, and on what share of its way that is right."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from gsut.run import StagedProgress, StageFollower
from gsut.run.staged_progress import count_down
from gsut.sfm.core.log import PosesLog
from gsut.sfm.time_left import PosesWork

_FACTOR, _SECONDS = 1.5, 1.0  # within which the time left is right
_FIRST = 10.0  # seconds that do not count
_GRID = 0.1  # seconds
_OFTEN = 0.01  # of all the time: rows of a record that are nearer are left out


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
        self.shown.append((self._clock(), self.estimate_left()))

    def shown_until(self, end: float) -> list[tuple[float, float]]:
        """What was shown, and at last nothing left."""
        return [*self.shown, (end, 0.0)]


class RecordedLog(PosesLog):
    """What a run of `gsut poses` tells, kept so that it can be told again.

    Attributes:
        work: what there was to do, as it was known at first.
        rows: seconds of the clock, what kind of telling, and its values.
    """

    def __init__(self, *told: Any, clock: Callable[[], float] = time.process_time) -> None:
        super().__init__(*told, clock=clock)
        self.work: dict[str, Any] = {}
        self.rows: list[list[Any]] = []
        self._within = False

    def _keep(self, *values: Any) -> None:
        if not self._within and (not self.rows or list(values) != self.rows[-1][1:]):
            self.rows.append([round(self._clock() - self._began, 2), *values])

    def expect(self, work: PosesWork, threads: int) -> None:
        self.work = dataclasses.asdict(work)
        super().expect(work, threads)

    def learn(self, **known: Any) -> None:
        if known and "settling" not in known:  # which is told again by itself
            self._keep("learn", known)
        super().learn(**known)

    def on_readout(self, share: float, text: str) -> None:
        self._keep("readout", share)
        self._within = True
        super().on_readout(share, text)
        self._within = False

    def show(self, stage: str, done: int, total: int, text: str) -> None:
        self._keep("show", stage, done, total)
        super().show(stage, done, total, text)

    def on_images(self, stage: str) -> Callable[[int, int, int, str], None]:
        tell = super().on_images(stage)
        self._keep("images", stage)

        def show(done: int, total: int, points: int, step: str) -> None:
            self._keep("step", stage, done, total, points, step)
            self._within = True
            tell(done, total, points, step)
            self._within = False

        return show

    def record(self, data: str) -> dict[str, Any]:
        """All of it, the end too; of what is told again and again, a part."""
        end = round(self._clock() - self._began, 2)
        kept: list[list[Any]] = []
        for row in self.rows:
            often = row[1] == "show" or row[-1] == "image"
            same = kept and kept[-1][1:3] == row[1:3]
            if not (often and same and row[0] - kept[-1][0] < _OFTEN * end):
                kept.append(row)
        return {"data": data, "work": self.work, "rows": [*kept, [end, "end"]]}


def told_again(record: Mapping[str, Any]) -> list[tuple[float, float]]:
    """When, and the seconds left that are shown where a run tells what another one told.

    Args:
        record: see `RecordedLog`.
    """
    now = 0.0
    bars = WatchedProgress({}, clock=lambda: now)
    stages = StageFollower(bars)
    log = PosesLog(stages.show, None, stages.expect, clock=lambda: now)
    log.expect(PosesWork(**record["work"]), 1)
    mappers: dict[str, Callable[[int, int, int, str], None]] = {}
    for seconds, kind, *values in record["rows"]:
        now = seconds
        if kind == "learn":
            log.learn(**values[0])
        elif kind == "show":
            log.show(*values, "")
        elif kind == "readout":
            log.on_readout(*values, "")
        elif kind == "images":
            mappers[values[0]] = log.on_images(values[0])
        elif kind == "step":
            mappers[values[0]](*values[1:])
    return bars.shown_until(now)


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
    left = np.array([count_down(lefts[i], t - moments[i]) for i, t in zip(last, now, strict=True)])
    true = moments[-1] - now
    ratio = left / true
    right = (ratio < _FACTOR) & (ratio > 1 / _FACTOR) | (np.abs(left - true) < _SECONDS)
    return 100.0 * float(right.mean())
