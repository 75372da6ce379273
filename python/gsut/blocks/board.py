"""Shows the progress of a training in blocks."""

from __future__ import annotations

from typing import Any

from gsut.blocks.workers import FIGURES, Job
from gsut.run import Progress, read_checkpoint


class Counter:
    """Counts views on a bar."""

    def __init__(self, bar: Progress, stage: str, total: int) -> None:
        self._bar, self._stage, self._total, self._done = bar, stage, total, 0

    def advance(self) -> None:
        self._done += 1
        self._bar.show(self._stage, min(self._done, self._total), self._total)


class Board:
    """Shows the steps of all blocks in a round on one bar.

    Attributes:
        peaks: for each block the most memory in MiB that its process has taken.
    """

    def __init__(self, jobs: list[Job], progress: bool) -> None:
        self._bar = Progress(progress)
        self.peaks: dict[int, float] = {}
        self._steps: dict[int, int] = {}
        self._ends: dict[int, tuple[int, int]] = {}
        for job in jobs:
            if job.task.is_file():
                task = read_checkpoint(job.task, ("begin", "end"))
                self._ends[job.block] = task["begin"], task["end"]
                state = job.read_state(FIGURES)
                self._steps[job.block] = task["begin"] if state is None else state["step"]

    def report(self, job: Job, message: dict[str, Any]) -> None:
        """Moves the bar according to a message of `run_job`."""
        self._steps[job.block] = message["step"]
        if message.get("peak_rss_mb"):
            self.peaks[job.block] = max(self.peaks.get(job.block, 0.0), message["peak_rss_mb"])
        done = sum(step - self._ends[block][0] for block, step in self._steps.items())
        total = sum(end - begin for begin, end in self._ends.values())
        finished = sum(self._steps[block] >= end for block, (_, end) in self._ends.items())
        text = f"block {job.block} at {message['step']}, {finished} of {len(self._ends)} done"
        self._bar.show("blocks", done, total, text)

    def close(self) -> None:
        """Ends the bar at its current state."""
        self._bar.close()
