"""Times the stages of a loop by the wall clock and as processor time of the whole process."""

from __future__ import annotations

import time


class Stopwatch:
    """Sums of each stage's time. A lap costs about a microsecond.

    Attributes:
        seconds: stage -> [wall, processor] seconds since the last `clear`. Processor time, summed
            over threads, does not depend on what else runs on the machine.
    """

    def __init__(self) -> None:
        self.seconds: dict[str, list[float]] = {}
        self.start()

    def clear(self) -> None:
        """Forgets all sums."""
        self.seconds = {}

    def start(self) -> None:
        """Starts the next lap."""
        self._wall, self._cpu = time.perf_counter(), time.process_time()

    def record_lap(self, stage: str) -> None:
        """Adds the time since the last lap, or `start`, to a stage."""
        wall, cpu = time.perf_counter(), time.process_time()
        total = self.seconds.setdefault(stage, [0.0, 0.0])
        total[0] += wall - self._wall
        total[1] += cpu - self._cpu
        self._wall, self._cpu = wall, cpu
