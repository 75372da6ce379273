"""One bar for a command of several stages, with an estimate of the time left for all of them."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any, TextIO

from gsut.run.progress import Progress

# The pace is the seconds taken over the seconds expected; so many seconds count as expected before
# anything is known.
_TRUST_SECONDS = 5.0


class StagedProgress:
    """The bar of a whole command.

    What is left is what was expected of it, times the pace so far: of this stage where it has one,
    of the stages before else.

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
        self._stage: str | None = None
        self._began = 0.0
        self._done = 0.0  # share of the stage
        self._shown = 0.0  # share of all: never goes back
        self._spent = self._planned = 0.0  # seconds of the stages done: taken, and expected

    def expect(self, stage: str, seconds: float) -> None:
        """Corrects what a stage that is not done will take."""
        if stage not in self.seconds:
            self._expected[stage] = seconds

    @contextlib.contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """One stage, from its beginning to its end."""
        self._stage, self._began, self._done = name, self._clock(), 0.0
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

    def show(self, share: float, text: str = "") -> None:
        """Moves the bar to this share of the stage, which never goes back.

        Args:
            share: of the stage's expected seconds, 0 to 1.
            text: its state in words.
        """
        self._done = min(1.0, max(self._done, share))
        left = self.left()
        gone = self._spent + (self._clock() - self._began if self._stage else 0.0)
        part = gone / (gone + left) if gone + left > 0 else 0.0
        self._shown = max(self._shown, part)
        words = f"{self._stage}: {text}" if text else str(self._stage)
        self._bars.show_share(self._shown, left, words)

    def left(self) -> float:
        """Seconds that are left of all stages."""
        name = self._stage
        before = (self._spent + _TRUST_SECONDS) / (self._planned + _TRUST_SECONDS)
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
        return pace * (expected - gone) + both * later

    def note(self, text: str) -> None:
        """A line of words above the bar."""
        self._bars.note(text)

    def __enter__(self) -> StagedProgress:
        return self

    def __exit__(self, *_: Any) -> None:
        self._bars.close()
