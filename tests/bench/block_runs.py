"""Trainings by the command, each a process of its own, with what it took."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from gsut._core import InputError

_KEPT = ("psnr", "psnr_min", "num_gaussians", "steps", "cpu_seconds", "seconds", "peak_mb")


def train_apart(data: Path, out: Path, flags: Sequence[str]) -> dict[str, Any]:
    """Trains and returns the content of metrics.json, with seconds, cpu_seconds and peak_mb.

    Args:
        data: the dataset.
        out: the run's folder; a finished one is read, an unfinished one is gone on with.
        flags: of `gsut train`.

    Returns:
        `cpu_seconds` are of all processes; `peak_mb` is of the largest: the driver or a worker.

    Raises:
        InputError: the training failed; its last line.
    """
    took = out.with_suffix(".json")
    if not took.is_file():
        command = [sys.executable, "-m", "gsut", "train", str(data), "-o", str(out), "--quiet"]
        command += [*flags, "--resume"] if out.exists() else flags
        began = time.perf_counter()
        process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        assert process.stderr is not None
        told = process.stderr.read()
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            last = told.strip().splitlines()[-1:] or [f"exit status {process.returncode}"]
            raise InputError(f"gsut train {data} {' '.join(flags)}: {last[0]}")
        figures = {
            "seconds": time.perf_counter() - began, "cpu_seconds": used.ru_utime + used.ru_stime
        }  # fmt: skip
        took.write_text(json.dumps(figures))
    metrics = json.loads((out / "metrics.json").read_text())
    rows = metrics.get("blocks", {}).get("rows", [])
    peaks = [metrics["peak_rss_mb"], *(row["peak_rss_mb"] or 0.0 for row in rows)]
    return metrics | json.loads(took.read_text()) | {"peak_mb": max(peaks)}


def figures_of(metrics: dict[str, Any]) -> dict[str, Any]:
    """What a row of a benchmark says of a training, from the result of `train_apart`.

    Of blocks `steps` are those of the coarse model, too, and `stages` what each took.
    """
    row = {name: metrics[name] for name in _KEPT}
    blocks = metrics.get("blocks")
    if blocks is None:
        return row
    row["steps"] += blocks["coarse"]["steps"]
    row["megapixels"] = blocks["pixels"] / 1e6
    row["megabytes"] = sum(stage["bytes"] for stage in blocks["stages"].values()) / 1e6
    return row | {"stages": blocks["stages"]}


def print_stages(rows: Sequence[dict[str, Any]], name: str) -> None:
    """A line a training in blocks: what its stages took; `name` is the key of the first word."""
    for row in rows:
        if "stages" in row:
            stages = ", ".join(
                f"{stage} {took['seconds']:.0f} s {took['bytes'] / 1e6:.1f} MB"
                for stage, took in row["stages"].items()
            )
            print(f"{row[name]}, {row['training'].strip()}: {stages}")
