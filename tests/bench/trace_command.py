"""Runs one gsut command on one thread and records where its time goes, to forecast it on more.

`python -m tests.bench.trace_command FILE WORD ...` writes the `Trace` of `gsut WORD ...` to FILE.
"""

from __future__ import annotations

import collections
import concurrent.futures
import dataclasses
import heapq
import importlib
import json
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

# Numbers of cores that the core forecasts its loops for.
CORES = (2, 4, 8, 16)
# Seconds between two looks at what the main thread does.
_TICK = 0.004
# Places kept of the serial time.
_MOST_PLACES = 200
# Cores that the time lost in loops and pools is stated for.
_JUDGED = 8


@dataclasses.dataclass
class Trace:
    """Where the processor seconds of a command's main thread went, with all work done on it.

    Attributes:
        seconds: of all.
        serial: of code that uses one core however many there are.
        background: of work that a thread of its own does beside the main one.
        parallel: by the number of cores: of loops and of pools of threads.
        few_chunks: of loops with fewer chunks than `_JUDGED` cores.
        longest_chunks: the longest chunk of each loop, summed.
        places: (place, seconds) of the serial time, the largest first.
        lost: (place, seconds) that loops take on `_JUDGED` cores beyond an even share.
    """

    seconds: float
    serial: float
    background: float
    parallel: dict[int, float]
    few_chunks: float
    longest_chunks: float
    places: list[tuple[str, float]]
    lost: list[tuple[str, float]]

    def forecast(self, cores: int) -> float:
        """Returns the seconds on this number of cores, were memory as fast for all of them."""
        if cores == 1:
            return self.seconds
        return max(self.serial + self.parallel[cores], self.seconds / cores)


class _Tasks:
    """The tasks of pools of threads, all done by the main thread at once."""

    def __init__(self) -> None:
        self.rows: list[tuple[int, bool, float, float]] = []  # pool, is background, begin, end
        self.depth = 0

    def make_executor(self) -> type[concurrent.futures.Executor]:
        """Makes the class that stands in for ThreadPoolExecutor."""
        tasks = self

        class Inline(concurrent.futures.Executor):
            def __init__(self, max_workers: int | None = None, *_: Any, **__: Any) -> None:
                self._is_background = max_workers == 1

            def submit(self, work: Any, /, *args: Any, **named: Any) -> concurrent.futures.Future:
                answer: concurrent.futures.Future = concurrent.futures.Future()
                begin, tasks.depth = time.thread_time(), tasks.depth + 1
                try:
                    answer.set_result(work(*args, **named))
                except BaseException as error:
                    answer.set_exception(error)
                tasks.depth -= 1
                if tasks.depth == 0:
                    row = id(self), self._is_background, begin, time.thread_time()
                    tasks.rows.append(row)
                return answer

        return Inline


class _Sampler:
    """Looks at the main thread from time to time: which line of gsut it is at."""

    def __init__(self) -> None:
        self.rows: list[tuple[float, str]] = []  # processor seconds so far, place
        self._thread = threading.main_thread().ident or 0
        self._clock = time.pthread_getcpuclockid(self._thread)
        self._over = threading.Event()
        threading.Thread(target=self._look, daemon=True).start()

    def stop(self) -> None:
        self._over.set()

    def _look(self) -> None:
        while not self._over.wait(_TICK):
            frame = sys._current_frames().get(self._thread)
            self.rows.append((time.clock_gettime(self._clock), _name_place(frame)))


def _name_place(frame: Any) -> str:
    """Names the innermost function of gsut, or "imports" while a module is being imported."""
    place = ""
    while frame is not None:
        code = frame.f_code
        if code.co_name == "_find_and_load":
            return "imports"
        if not place and "/gsut/" in code.co_filename:
            place = f"{code.co_filename.rpartition('/gsut/')[2]}: {code.co_name}"
        frame = frame.f_back
    return place or "start of Python"


def schedule(seconds: Sequence[float], cores: int) -> float:
    """Returns how long tasks take where each core takes the next one once it is free."""
    busy = [0.0] * cores
    for each in seconds:
        heapq.heapreplace(busy, busy[0] + each)
    return max(busy)


def trace_command(words: Sequence[str]) -> tuple[int, Trace]:
    """Runs `gsut WORDS` and returns its exit status and its trace."""
    tasks = _Tasks()
    concurrent.futures.ThreadPoolExecutor = tasks.make_executor()  # type: ignore[misc, assignment]
    sampler = _Sampler()
    core = importlib.import_module("gsut._core")
    core.trace_loops(True)
    status = importlib.import_module("gsut.cli").main(list(words))
    sampler.stop()
    return status, _summarize(time.thread_time(), core.take_traced_loops(), tasks.rows, sampler)


def _summarize(
    seconds: float,
    loops: np.ndarray,
    tasks: Sequence[tuple[int, bool, float, float]],
    sampler: _Sampler,
) -> Trace:
    begins = np.array([row[2] for row in tasks])
    ends = np.array([row[3] for row in tasks])
    # Loops within a task count as that task's.
    at = np.searchsorted(begins, loops[:, 0], side="right") - 1
    inside = (at >= 0) & (loops[:, 1] <= ends[at]) if len(ends) else np.zeros(len(loops), bool)
    loops = loops[~inside]
    loops = loops[np.argsort(loops[:, 0], kind="stable")]
    pools: dict[int, list[float]] = collections.defaultdict(list)
    background = 0.0
    for pool, is_background, begin, end in tasks:
        if is_background:
            background += end - begin
        else:
            pools[pool].append(end - begin)
    took = loops[:, 1] - loops[:, 0]
    parallel = {
        cores: float(loops[:, 4 + k].sum()) + sum(schedule(p, cores) for p in pools.values())
        for k, cores in enumerate(CORES)
    }
    busy = float(took.sum()) + background + sum(map(sum, pools.values()))
    covered = sorted([*zip(loops[:, 0], loops[:, 1], strict=True), *zip(begins, ends, strict=True)])
    places, of_loops = _place_samples(sampler.rows, covered)
    lost: dict[str, float] = collections.defaultdict(float)
    for loop, length in zip(loops, took, strict=True):
        lost[of_loops(loop[0])] += loop[4 + CORES.index(_JUDGED)] - length / _JUDGED
    few = loops[:, 3] < _JUDGED
    return Trace(
        seconds, seconds - busy, background, parallel, float(took[few].sum()),
        float(loops[:, 2].sum()), _list_largest(places), _list_largest(lost),
    )  # fmt: skip


def _place_samples(
    rows: Sequence[tuple[float, str]], covered: Sequence[tuple[float, float]]
) -> tuple[dict[str, float], Any]:
    """Returns the serial seconds of each place, and a function that names the place at a time.

    Args:
        rows: looks at the main thread.
        covered: begin and end of loops and tasks, which are not serial, in order.
    """
    times = np.array([row[0] for row in rows])
    ends = np.array(covered or [(0.0, 0.0)])
    lengths = np.cumsum(ends[:, 1] - ends[:, 0])
    starts = np.concatenate([[0.0], lengths[:-1]])
    before = np.interp(times, ends.ravel(), np.stack([starts, lengths], axis=1).ravel())
    places: dict[str, float] = collections.defaultdict(float)
    for (_, place), seconds in zip(rows, np.diff(times - before, prepend=0.0), strict=True):
        places[place] += float(seconds)

    def find_place(at: float) -> str:
        index = min(len(rows) - 1, int(np.searchsorted(times, at)))
        return rows[index][1] if rows else ""

    return places, find_place


def _list_largest(places: dict[str, float]) -> list[tuple[str, float]]:
    return sorted(places.items(), key=lambda item: -item[1])[:_MOST_PLACES]


def main(words: Sequence[str]) -> int:
    status, trace = trace_command(words[1:])
    Path(words[0]).write_text(json.dumps(dataclasses.asdict(trace)))
    return status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
