"""Runs whole `gsut` commands as processes of their own, and measures what they take."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from gsut._core import InputError
from tests.bench.harness import Row

_TOOK = "took.json"


def run_gsut(words: Sequence[str], out: Path) -> Row:
    """Runs a command that fills `out`, unless it has been run: `seconds`, `cpu_seconds`, `peak_mb`.

    `peak_mb` is that of the largest process.

    Raises:
        InputError: the command fails; its last line.
    """
    took = out.with_name(f"{out.name}.{_TOOK}")
    if not took.is_file():
        command = [sys.executable, "-m", "gsut", *words, "-o", str(out), "--quiet"]
        began = time.perf_counter()
        with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
            assert process.stderr is not None
            said = process.stderr.read()
            _, status, used = os.wait4(process.pid, 0)
            process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            last = said.strip().splitlines()[-1:] or [f"exit status {process.returncode}"]
            raise InputError(f"gsut {' '.join(words)}: {last[0]}")
        figures = {
            "seconds": time.perf_counter() - began,
            "cpu_seconds": used.ru_utime + used.ru_stime,
            "peak_mb": used.ru_maxrss / 1024,
        }
        took.write_text(json.dumps(figures))
    return json.loads(took.read_text())


def train(data: Path, out: Path, words: Sequence[str]) -> Row:
    """Runs `gsut train`: its metrics.json, with what the whole command took."""
    took = run_gsut(["train", str(data), *words], out)
    metrics = json.loads((out / "metrics.json").read_text())
    rows = metrics.get("blocks", {}).get("rows", [])
    peaks = [metrics["peak_rss_mb"], *(row["peak_rss_mb"] or 0.0 for row in rows)]
    return metrics | took | {"peak_mb": max(peaks)}
