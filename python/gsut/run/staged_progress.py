"""One bar for a command of several stages, with an estimate of the time left for all of them."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any, TextIO

from gsut.run.progress import Progress

# The pace is the seconds taken over the seconds expected; so many seconds count as expected before
# anything is known.
_TRUST_SECONDS = 5.0
# Power of the pace that holds for the stages to come: a machine is slower in all, but what was
# expected of one stage may be wrong by itself.
_SHARED = 0.75
_TICK = 1.0  # seconds between two refreshes while nothing is told
_LEAST = 0.25  # of the seconds left that were told last: fewer are not shown before more is told


class StagedProgress:
    """The bar of a whole command.

    What is left is what was expected of it, times the pace so far: of this stage where it has one,
    else, less surely, of the stages before.

    Args:
        expected: seconds that each stage takes, in order; `expect` corrects them.
        enabled: False shows nothing.
        file: where to write; standard error if None.
        clock: seconds; for tests.

    Attributes:
        seconds: taken by each stage that is done.
    """

    def __init__(
        self,
        expected: Mapping[str, float],
        enabled: bool = True,
        file: TextIO | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.seconds: dict[str, float] = {}
        self._expected = dict(expected)
        self._bars = Progress(enabled, file)
        self._clock = clock
        self._last: tuple[float, float, str] | None = None  # when, seconds left, words
        self._lock = threading.Lock()
        self._over = threading.Event()
        self._enabled = enabled
        self._stage: str | None = None
        self._began = 0.0
        self._done = 0.0  # share of the stage
        self._told: float | None = None  # seconds left of the stage, by who knows better
        self._shown = 0.0  # share of all: never goes back
        self._spent = self._planned = 0.0  # seconds of the stages done: taken, and expected

    def expect(self, stage: str, seconds: float) -> None:
        """Corrects what a stage that is not done will take, or names one that will come."""
        if stage not in self.seconds:
            self._expected[stage] = seconds

    @contextlib.contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """One stage, from its beginning to its end."""
        self._stage, self._began, self._done, self._told = name, self._clock(), 0.0, None
        yield
        taken = self._clock() - self._began
        self.seconds[name] = taken
        self._spent += taken
        self._planned += self._expected[name]
        self._stage = None

    def skip(self, name: str) -> None:
        """A stage that was done before."""
        self.seconds[name] = 0.0
        self._expected[name] = 0.0

    def show(self, share: float, text: str = "", left: float | None = None) -> None:
        """Moves the bar to this share of the stage, which never goes back.

        Args:
            share: of the stage's expected seconds, 0 to 1.
            text: its state in words.
            left: seconds that the stage still takes, where who does the work knows it better.
        """
        self._done, self._told = min(1.0, max(self._done, share)), left
        words = f"{self._stage}: {text}" if text else str(self._stage)
        with self._lock:
            self._last = self._clock(), self.left(), words
            self._refresh()

    def _refresh(self) -> None:
        """Shows what was told last, less the time since."""
        if self._last is None:
            return
        at, told, words = self._last
        now = self._clock()
        left = counted_down(told, now - at)
        gone = self._spent + (now - self._began if self._stage else 0.0)
        part = gone / (gone + left) if gone + left > 0 else 0.0
        self._shown = max(self._shown, part)
        self._bars.show_share(self._shown, left, words)

    def _tick(self) -> None:
        while not self._over.wait(_TICK):
            with self._lock:
                self._refresh()

    def left(self) -> float:
        """Seconds that are left of all stages."""
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
        # Until it is clear, the pace of this stage is that of those before.
        pace = (taken + before * _TRUST_SECONDS) / (gone + _TRUST_SECONDS)
        both = (self._spent + taken + _TRUST_SECONDS) / (self._planned + gone + _TRUST_SECONDS)
        own = pace * (expected - gone) if self._told is None else self._told
        return own + both**_SHARED * later

    def note(self, text: str) -> None:
        """A line of words above the bar."""
        with self._lock:
            self._bars.note(text)

    def __enter__(self) -> StagedProgress:
        if self._enabled:
            threading.Thread(target=self._tick, daemon=True).start()
        return self

    def __exit__(self, *_: Any) -> None:
        self._over.set()
        with self._lock:
            self._bars.close()


def counted_down(told: float, since: float) -> float:
    """Seconds left that are shown so long after they were told."""
    return max(told - since, _LEAST * told)
