"""One bar for a command of several stages, with an estimate of the time left for all of them."""

from __future__ import annotations

import contextlib
import os
import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, TextIO

from gsut.files import FileError, Number, read_json, write_json
from gsut.run.progress import Progress

# Of each stage in the file of last runs.
_SECONDS = "seconds"
_WORK = "work"
_LastRun = dict[str, dict[str, float]]  # seconds and work of each stage; work 0: not known
_SHORT = 0.1  # of all stages' seconds: what is shorter says nothing about the others
# Taken for the last run before there is one: a film of 17 frames of 640 x 480, preset balanced, two
# cores of AMD EPYC.
_FIRST_RUNS: dict[str, _LastRun] = {
    "scene": {
        "capture": {_SECONDS: 0.6},
        "features": {_SECONDS: 1.2, _WORK: 17},
        "matching": {_SECONDS: 0.5, _WORK: 17},
        "lens": {_SECONDS: 1.5, _WORK: 17},
        "mapping": {_SECONDS: 10, _WORK: 17},
        "training": {_SECONDS: 67, _WORK: 2000 * 640},
    }
}


class StagedProgress:
    """The bar of a whole command.

    The time left of a stage follows from its own pace since its first report. All other stages take
    as long as in the last run on this machine, faster or slower as those were that have taken
    their time, this one included; stages that were not in it take as long as the median of the
    others, and say nothing about these.

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
        on_progress: Callable[[dict[str, Any]], None] = lambda row: None,
    ) -> None:
        self.seconds: dict[str, float] = {}
        self._command, self._stages = command, list(stages)
        self._before = _read_last_runs().get(command) or _FIRST_RUNS.get(command, {})
        self._last_run = {name: row.get(_SECONDS, 0.0) for name, row in self._before.items()}
        self._bars, self._enabled = Progress(enabled, file), enabled
        self._clock, self._on_progress = clock, on_progress
        self._work: dict[str, float] = {}  # units of stages, where they are known
        self._stage: str | None = None
        self._began = 0.0
        self._done = 0.0  # share of the stage
        self._first: tuple[float, float] | None = None  # its first report: time and share
        self._stage_left: float | None = None  # seconds left of the stage, if it reports them
        self._shown = 0.0  # share of the whole; never decreases

    def expect(self, *stages: str) -> None:
        """Adds stages."""
        self._stages += [name for name in stages if name not in self._stages]

    @contextlib.contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """One stage, from its beginning to its end."""
        self.expect(name)
        self._stage, self._began, self._done, self._stage_left = name, self._clock(), 0.0, None
        self._first = None
        yield
        self.seconds[name] = self._clock() - self._began
        self._stage = None

    def scale(self, stages: Sequence[str], work: float) -> None:
        """Expects stages to take as long as in the last run per unit of work, such as a picture."""
        for name in stages:
            self._work[name], row = work, self._before.get(name, {})
            if row.get(_WORK, 0.0) > 0:
                self._last_run[name] = row.get(_SECONDS, 0.0) * work / row[_WORK]

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
        self._first = self._first or (self._clock(), self._done)
        seconds_left = self.estimate_left()
        gone = sum(self.seconds.values()) + (self._clock() - self._began if self._stage else 0.0)
        if gone + seconds_left > 0:
            self._shown = max(self._shown, gone / (gone + seconds_left))
        words = f"{self._stage}: {text}" if text else str(self._stage)
        self._bars.show_share(self._shown, seconds_left, words)
        self._on_progress({
            "stage": self._stage, "share": self._shown, "text": text, "seconds_left": seconds_left,
        })  # fmt: skip

    def estimate_left(self) -> float:
        """Returns the seconds left of all stages."""
        last = {name: s for name, s in self._last_run.items() if name in self._stages}
        typical = statistics.median(last.values()) if last else 1.0
        before = {name: last.get(name, typical) for name in self._stages}
        spent = {name: self.seconds[name] for name in self._stages if name in self.seconds}
        short, own, early = _SHORT * sum(before.values()), 0.0, ""
        if self._stage is not None:
            now, own = self._clock(), before[self._stage]
            since, at = self._first or (now, 0.0)
            if self._done <= at:  # one report: the share may have been there from the start
                since, at = self._began, 0.0
            if self._stage_left is not None or self._done > at:
                left = self._stage_left
                own = (now - since) * (1 - self._done) / (self._done - at) if left is None else left
                spent[self._stage] = now - self._began + own
            early = self._stage if now - self._began < short else ""
        known = [name for name in spent if name in (last or before) and name != early]
        long = [name for name in known if before[name] >= short]
        planned = sum(before[name] for name in long)
        pace = sum(spent[name] for name in long) / planned if planned > 0 else 1.0
        if self._stage is not None and self._stage not in spent:
            own *= pace
        later = (before[name] for name in self._stages if name not in spent and name != self._stage)
        return own + pace * sum(later)

    def note(self, text: str) -> None:
        """Prints a line above the bar."""
        self._bars.note(text)

    def __enter__(self) -> StagedProgress:
        return self

    def __exit__(self, error: Any, *_: Any) -> None:
        self._bars.close()
        is_whole = self._stages and all(name in self.seconds for name in self._stages)
        if self._enabled and error is None and is_whole:
            rows = {
                name: {_SECONDS: self.seconds[name], _WORK: self._work.get(name, 0.0)}
                for name in self._stages
            }
            _write_last_run(self._command, rows)


class StageFollower:
    """Moves a bar through the stages of a function that reports them, such as `find_poses`.

    Args:
        bars: the bar; its stages are opened and closed as the reports come in.
        pictures: to which the stages' time is proportional; None: not known.
    """

    def __init__(self, bars: StagedProgress, pictures: int | None = None) -> None:
        self._bars, self._pictures = bars, pictures
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
        if self._pictures is not None:
            self._bars.scale(stages, self._pictures)

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


def _read_last_runs() -> dict[str, _LastRun]:
    try:
        return read_json(_find_last_runs(), {"*": {"*": {"*": Number(least=0)}}})
    except (FileError, RuntimeError):
        return {}


def _write_last_run(command: str, rows: _LastRun) -> None:
    with contextlib.suppress(OSError, RuntimeError):  # a machine that keeps nothing estimates alone
        path, runs = _find_last_runs(), _read_last_runs() | {command: rows}
        path.parent.mkdir(parents=True, exist_ok=True)
        write_json(path, runs)
