"""One bar for a command of several stages, with an estimate of the time left for all of them."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any, TextIO

from gsut.run.progress import Progress

# The pace is seconds taken / seconds expected. It starts as if this many seconds had gone exactly
# as expected, so that the first moments of a command do not decide the estimate.
_TRUST_SECONDS = 5.0
# Power of the pace that is applied to later stages: a slow machine is slow in all of them, but one
# stage's expectation may be wrong by itself.
_SHARED = 0.75
# Seconds between two refreshes while no stage reports anything.
_TICK = 1.0
# The countdown between two reports stops at this share of the time last reported.
_LEAST = 0.25


class StagedProgress:
    """The bar of a whole command.

    The time left of a stage is its expected time multiplied by the pace so far: the pace of the
    stage itself if it has started, otherwise, with less weight, that of the earlier stages.

    Args:
        expected: seconds that each stage takes, in order; `expect` corrects them.
        enabled: False shows nothing.
        file: where to write; standard error if None.
        clock: seconds; for tests.
        on_progress: receives {"stage", "share", "seconds_left", "text"} at every `show`.
        pace: by which expected seconds are multiplied: how slow this machine is.

    Attributes:
        seconds: taken by each stage that is finished.
    """

    def __init__(
        self,
        expected: Mapping[str, float],
        enabled: bool = True,
        file: TextIO | None = None,
        clock: Callable[[], float] = time.monotonic,
        on_progress: Callable[[dict[str, Any]], None] | None = None,
        pace: float = 1.0,
    ) -> None:
        self.seconds: dict[str, float] = {}
        self._expected = {stage: pace * seconds for stage, seconds in expected.items()}
        self._pace_of_machine = pace
        self._bars = Progress(enabled, file)
        self._clock, self._on_progress = clock, on_progress
        self._last: tuple[float, float, str] | None = None  # time of report, seconds left, words
        self._lock = threading.Lock()
        self._over = threading.Event()
        self._enabled = enabled
        self._stage: str | None = None
        self._began = 0.0
        self._done = 0.0  # share of the stage
        self._stage_left: float | None = None  # seconds left of the stage, if it reports them
        self._shown = 0.0  # share of the whole; never decreases
        self._spent = self._planned = 0.0  # seconds of the finished stages: taken, and expected

    def expect(self, stage: str, seconds: float) -> None:
        """Corrects the expected time of a stage that is not finished, or adds a stage."""
        if stage not in self.seconds:
            self._expected[stage] = self._pace_of_machine * seconds

    @contextlib.contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """One stage, from its beginning to its end."""
        self._stage, self._began, self._done, self._stage_left = name, self._clock(), 0.0, None
        yield
        taken = self._clock() - self._began
        self.seconds[name] = taken
        self._spent += taken
        self._planned += self._expected[name]
        self._stage = None

    def skip(self, name: str) -> None:
        """Removes a stage that was finished before from the time left."""
        self.seconds[name] = 0.0
        self._expected[name] = 0.0

    def show(self, share: float, text: str = "", left: float | None = None) -> None:
        """Moves the bar to this share of the stage; a smaller share than before is ignored.

        Args:
            share: of the stage's expected seconds, 0 to 1.
            text: its state in words.
            left: seconds left of the stage, if the stage estimates them itself.
        """
        self._done, self._stage_left = min(1.0, max(self._done, share)), left
        words = f"{self._stage}: {text}" if text else str(self._stage)
        with self._lock:
            self._last = self._clock(), self.estimate_left(), words
            self._refresh()
        if self._on_progress is not None:
            row = {"stage": self._stage, "share": self._shown, "text": text}
            self._on_progress({**row, "seconds_left": self._last[1]})

    def _refresh(self) -> None:
        """Shows the last report, with the time since then counted down."""
        if self._last is None:
            return
        at, reported, words = self._last
        now = self._clock()
        left = count_down(reported, now - at)
        gone = self._spent + (now - self._began if self._stage else 0.0)
        part = gone / (gone + left) if gone + left > 0 else 0.0
        self._shown = max(self._shown, part)
        self._bars.show_share(self._shown, left, words)

    def _refresh_until_over(self) -> None:
        while not self._over.wait(_TICK):
            with self._lock:
                self._refresh()

    def estimate_left(self) -> float:
        """Returns the seconds left of all stages."""
        name = self._stage
        before = ((self._spent + _TRUST_SECONDS) / (self._planned + _TRUST_SECONDS)) ** _SHARED
        later = sum(
            seconds for key, seconds in self._expected.items()
            if key not in self.seconds and key != name
        )  # fmt: skip
        if name is None:
            return before * later
        expected = self._expected[name]
        taken, gone = self._clock() - self._began, self._done * expected
        # A stage that has just started goes at the pace of the stages before it.
        pace = (taken + before * _TRUST_SECONDS) / (gone + _TRUST_SECONDS)
        both = (self._spent + taken + _TRUST_SECONDS) / (self._planned + gone + _TRUST_SECONDS)
        own = pace * (expected - gone) if self._stage_left is None else self._stage_left
        return own + both**_SHARED * later

    def note(self, text: str) -> None:
        """Prints a line above the bar."""
        with self._lock:
            self._bars.note(text)

    def __enter__(self) -> StagedProgress:
        if self._enabled:
            threading.Thread(target=self._refresh_until_over, daemon=True).start()
        return self

    def __exit__(self, *_: Any) -> None:
        self._over.set()
        with self._lock:
            self._bars.close()


class StageFollower:
    """Moves a bar through the stages of a function that reports them, such as `find_poses`.

    Args:
        bars: the bar; its stages are opened and closed as the reports come in.
    """

    def __init__(self, bars: StagedProgress) -> None:
        self._bars = bars
        self._names: list[str] = []
        self._stage = ""
        self._open = contextlib.ExitStack()

    @property
    def seconds(self) -> float:
        """Seconds taken by all finished stages."""
        return sum(self._bars.seconds.get(name, 0.0) for name in self._names)

    def expect(self, seconds: Mapping[str, float]) -> None:
        """Sets the stages and their expected seconds; stages that are missing now are skipped."""
        for name in set(self._names) - set(seconds):
            self._bars.skip(name)
        self._names = list(seconds)
        for name, expected in seconds.items():
            self._bars.expect(name, expected)

    def show(self, stage: str, done: int, total: int, text: str) -> None:
        """Shows how much of a stage is done; an unexpected stage counts to the one before it."""
        if stage not in self._names:
            return
        if stage != self._stage:
            self._open.close()
            for name in self._names[: self._names.index(stage)]:
                if name not in self._bars.seconds:
                    self._bars.skip(name)
            self._stage = stage
            self._open.enter_context(self._bars.stage(stage))
        self._bars.show(done / max(1, total), text)

    def close(self) -> None:
        """Ends the last stage."""
        self._open.close()


def count_down(reported: float, since: float) -> float:
    """Returns the seconds left to show `since` seconds after `reported` seconds were left."""
    return max(reported - since, _LEAST * reported)
