"""Runs the commands of gsut on a capture, each with its seconds and how it ended."""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

_LIMIT = 240.0  # seconds of one command


@dataclasses.dataclass(frozen=True)
class Outcome:
    """How a command ended.

    Attributes:
        status: exit status; None: stopped at the time limit.
        cpu_seconds: of it and its children.
        output, errors: what it printed.
    """

    status: int | None
    cpu_seconds: float
    output: str
    errors: str

    @property
    def has_traceback(self) -> bool:
        """Whether it ended in a way that no command may."""
        return "Traceback (most recent call last)" in self.errors or (self.status or 0) < 0

    @property
    def last_line(self) -> str:
        """The last line of what it printed as an error."""
        lines = self.errors.strip().splitlines()
        return lines[-1] if lines else ""


def run_gsut(*words: str | Path, work: Path, limit: float = _LIMIT) -> Outcome:
    """Runs `gsut WORDS` and waits for it."""
    command = [sys.executable, "-m", "gsut", *map(str, words)]
    output, errors = work / "output.txt", work / "errors.txt"
    with output.open("wb") as out, errors.open("wb") as err:
        process = subprocess.Popen(command, stdout=out, stderr=err, stdin=subprocess.DEVNULL)
        started, status = time.monotonic(), None
        while True:
            pid, ended, usage = os.wait4(process.pid, os.WNOHANG)
            if pid:
                status = os.waitstatus_to_exitcode(ended)
                process.returncode = status
                break
            if time.monotonic() - started > limit:
                process.kill()
                _, _, usage = os.wait4(process.pid, 0)
                process.returncode = -9
                break
            time.sleep(0.02)
    return Outcome(
        status,
        usage.ru_utime + usage.ru_stime,
        output.read_text("utf-8", "replace"),
        errors.read_text("utf-8", "replace"),
    )


def run_training(data: Path, out: Path, *words: str, work: Path) -> tuple[Outcome, dict[str, Any]]:
    """Runs `gsut train`: how it ended, and metrics.json, empty if it failed."""
    outcome = run_gsut("train", data, "-o", out, "--quiet", *words, work=work)
    done = outcome.status == 0
    return outcome, json.loads((out / "metrics.json").read_text("utf-8")) if done else {}
