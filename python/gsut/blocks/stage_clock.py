"""Adds up the seconds that the stages of a training in blocks take."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator

from gsut.run import RunFile, RunFolder, release_memory

# Path of the stages' times in the run's folder.
_STAGES = f"{RunFile.BLOCKS}/stages.json"


class StageClock:
    """The seconds of a run's stages over all its processes.

    Args:
        run: its folder, where they are kept.

    Attributes:
        seconds: of each stage, by its name.
    """

    def __init__(self, run: RunFolder) -> None:
        self._run = run
        self.seconds: dict[str, float] = run.read_json(_STAGES) or {}

    @contextlib.contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Adds the seconds of a stage to those of the run."""
        began = time.perf_counter()
        try:
            yield
        finally:
            taken = time.perf_counter() - began
            self.seconds[name] = self.seconds.get(name, 0.0) + taken
            release_memory()
            self._run.write_json(_STAGES, self.seconds)
