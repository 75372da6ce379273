"""Adds up what the stages of a training in blocks take: seconds, and bytes written."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator

from gsut.run import RunFile, RunFolder, release_memory

# Path of the stages' times and sizes in the run's folder.
_STAGES = f"{RunFile.BLOCKS}/stages.json"


class StageClock:
    """The seconds and bytes of a run's stages over all its processes.

    Args:
        run: its folder, where they are kept.

    Attributes:
        rows: name of a stage -> "seconds" and "bytes".
    """

    def __init__(self, run: RunFolder) -> None:
        self._run = run
        self.rows: dict[str, dict[str, float]] = run.read_json(_STAGES) or {}

    @contextlib.contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Adds the seconds of a stage, and the bytes that it wrote, to those of the run."""
        began, before = time.perf_counter(), self._count_bytes()
        try:
            yield
        finally:
            row = self.rows.setdefault(name, {"seconds": 0.0, "bytes": 0})
            row["seconds"] += time.perf_counter() - began
            row["bytes"] += self._count_bytes() - before
            release_memory()
            self._run.write_json(_STAGES, self.rows)

    def count_seconds(self) -> float:
        """Returns the seconds of all stages."""
        return sum(row["seconds"] for row in self.rows.values())

    def _count_bytes(self) -> int:
        folder = self._run.path / RunFile.BLOCKS
        return sum(file.stat().st_size for file in folder.rglob("*.npz"))
