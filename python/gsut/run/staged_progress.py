"""One bar for a command of several stages, with an estimate of the time left for all of them."""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, TextIO

from gsut.files import FileError, Number, read_json, write_json
from gsut.run.progress import Progress

# Seconds between two refreshes while no stage reports anything.
_TICK = 1.0
# The countdown between two reports stops at this share of the time last reported.
_LEAST = 0.25
# Share of all stages' seconds below which a stage says nothing about the others.
_SHORT = 0.05
_WORK = " work"  # after a command's name: its row of work in the file of last runs


class StagedProgress:
    """The bar of a whole command.

    The time left of a stage follows from its own pace, once it has reported some progress. All
    other stages take as long as in the last run on this machine, by their work and
    beside the finished ones; those that were not in it take as long as the mean of the others.

    Args:
        command: whose last run is read, and written once all stages have ended.
        stages: in order; `expect` adds more.
        enabled: False shows nothing.
        file: where to write; standard error if None.
        clock: seconds; for tests.
        on_progress: receives {"stage", "share", "seconds_left", "text"} at every `show`.

    Attributes:
        seconds: taken by each stage that is finished.
    """

    def __init__(
        self,
        command: str,
        stages: Sequence[str] = (),
        enabled: bool = True,
        file: TextIO | None = None,
        clock: Callable[[], float] = time.monotonic,
        on_progress: Callable[[dict[str, Any]], None] | None = None,
    ) -> None:
        self.seconds: dict[str, float] = {}
        self._command, self._stages = command, list(stages)
        runs = _read_last_runs()
        self._last_run: dict[str, float] = runs.get(command, {})
        self._last_work: dict[str, float] = runs.get(command + _WORK, {})
        self._work: dict[str, float] = {}
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

    def expect(self, *stages: str) -> None:
        """Adds stages."""
        self._stages += [name for name in stages if name not in self._stages]

    def plan(self, work: float, *stages: str) -> None:
        """Sets the work of stages, such as pictures or steps, to which their time is proportional.
        Without it they have as much as in the last run."""
        self._work |= dict.fromkeys(stages, work)

    @contextlib.contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """One stage, from its beginning to its end."""
        self.expect(name)
        self._stage, self._began, self._done, self._stage_left = name, self._clock(), 0.0, None
        yield
        self.seconds[name] = self._clock() - self._began
        self._stage = None

    def skip(self, name: str) -> None:
        """Removes a stage that was finished before from the time left."""
        if name in self._stages:
            self._stages.remove(name)
        self.seconds.setdefault(name, 0.0)

    def show(self, share: float, text: str = "", left: float | None = None) -> None:
        """Moves the bar to this share of the stage; a smaller share than before is ignored.

        Args:
            share: of the stage's seconds, 0 to 1.
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
        left = max(reported - (now - at), _LEAST * reported)
        gone = sum(self.seconds.values()) + (now - self._began if self._stage else 0.0)
        part = gone / (gone + left) if gone + left > 0 else 0.0
        self._shown = max(self._shown, part)
        self._bars.show_share(self._shown, left, words)

    def _refresh_until_over(self) -> None:
        while not self._over.wait(_TICK):
            with self._lock:
                self._refresh()

    def estimate_left(self) -> float:
        """Returns the seconds left of all stages."""
        last = {
            name: seconds * self._compare_work(name)
            for name, seconds in self._last_run.items()
            if name in self._stages
        }
        mean = sum(last.values()) / len(last) if last else 1.0
        before = {name: last.get(name, mean) for name in self._stages}
        spent = {name: self.seconds[name] for name in self._stages if name in self.seconds}
        own = 0.0
        if self._stage is not None:
            taken, own = self._clock() - self._began, before[self._stage]
            if self._stage_left is not None:
                own = self._stage_left
            elif self._done > 0:
                own = taken * (1 - self._done) / self._done
            if self._stage_left is not None or self._done > 0:
                spent[self._stage] = taken + own
        whole = sum(before.values())
        long = [name for name in spent if before[name] >= _SHORT * whole]
        planned = sum(before[name] for name in long)
        pace = sum(spent[name] for name in long) / planned if planned > 0 else 1.0
        if self._stage is not None and self._stage not in spent:
            own *= pace
        later = (before[name] for name in self._stages if name not in spent and name != self._stage)
        return own + pace * sum(later)

    def _compare_work(self, name: str) -> float:
        """Returns the work of a stage over that of the last run; 1 where either is unknown."""
        work, last = self._work.get(name, 0.0), self._last_work.get(name, 0.0)
        return work / last if work > 0 and last > 0 else 1.0

    def note(self, text: str) -> None:
        """Prints a line above the bar."""
        with self._lock:
            self._bars.note(text)

    def __enter__(self) -> StagedProgress:
        if self._enabled:
            threading.Thread(target=self._refresh_until_over, daemon=True).start()
        return self

    def __exit__(self, error: Any, *_: Any) -> None:
        self._over.set()
        with self._lock:
            self._bars.close()
        is_whole = self._stages and all(name in self.seconds for name in self._stages)
        if self._enabled and error is None and is_whole:
            seconds = {name: self.seconds[name] for name in self._stages}
            _write_last_runs({self._command: seconds, self._command + _WORK: self._work})


class StageFollower:
    """Moves a bar through the stages of a function that reports them, such as `find_poses`.

    Args:
        bars: the bar; its stages are opened and closed as the reports come in.
        work: of each stage; None: not known.
    """

    def __init__(self, bars: StagedProgress, work: float | None = None) -> None:
        self._bars = bars
        self._work = work
        self._names: list[str] = []
        self._stage = ""
        self._open = contextlib.ExitStack()

    @property
    def seconds(self) -> float:
        """Seconds taken by all finished stages."""
        return sum(self._bars.seconds.get(name, 0.0) for name in self._names)

    def expect(self, stages: Sequence[str]) -> None:
        """Sets the stages, in order."""
        self._names = list(stages)
        self._bars.expect(*stages)
        if self._work is not None:
            self._bars.plan(self._work, *stages)

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
        """Ends the last stage; those that did not come are left out."""
        self._open.close()
        for name in self._names:
            if name not in self._bars.seconds:
                self._bars.skip(name)


def _find_last_runs() -> Path:
    """Returns the file of the seconds that the stages of each command took on this machine."""
    cache = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(cache) / "gsut" / "stages.json"


def _read_last_runs() -> dict[str, dict[str, float]]:
    try:
        return read_json(_find_last_runs(), {"*": {"*": Number(least=0)}})
    except (FileError, RuntimeError):
        return {}


def _write_last_runs(changed: dict[str, dict[str, float]]) -> None:
    with contextlib.suppress(OSError, RuntimeError):  # a machine that keeps nothing estimates alone
        path, runs = _find_last_runs(), _read_last_runs() | changed
        path.parent.mkdir(parents=True, exist_ok=True)
        write_json(path, runs)
