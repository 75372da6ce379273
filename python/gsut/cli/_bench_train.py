"""`gsut bench train`: whole commands of training, timed beside what they reach."""

from __future__ import annotations

import argparse
import math
import os
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from gsut._core import InputError
from gsut.cli._flags import add_json, finite, print_json
from gsut.run import RunFile, RunFolder
from gsut.run.options import PRESETS

HELP = "held-out PSNR against the seconds of whole commands, beside other versions of gsut"
DESCRIPTION = (
    "Runs `gsut train` with each preset, or other flags, as a process of its own, with this gsut "
    "and other ones by turns. Seconds and processor seconds are those of the whole command: "
    "imports, decoding, evaluation and report count."
)
_THIS = "this"
_FIGURES = ("psnr", "ssim", "num_gaussians", "steps", "train_seconds")


def add_flags(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("data", metavar="DATA", help="dataset with held-out views")
    parser.add_argument(
        "--run", metavar="WORDS", dest="runs", action="append",
        help="a run by flags of gsut train, such as --run='--steps 400 --max-gaussians 50000'; may "
        "be repeated [default: each preset]",
    )  # fmt: skip
    parser.add_argument(
        "--flags", metavar="WORDS", default="",
        help="of all runs, such as --flags='--scale 0.25 --set init=random'",
    )  # fmt: skip
    parser.add_argument(
        "--against", metavar="GSUT", action="append", default=[],
        help="command of another version, such as ../old/.venv/bin/gsut; may be repeated",
    )  # fmt: skip
    parser.add_argument(
        "--level", metavar="DB", type=finite, action="append", default=[], dest="levels",
        help="report the seconds to this PSNR, interpolated between two runs; may be repeated",
    )  # fmt: skip
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
    versions = {_THIS: [sys.executable, "-m", "gsut"]}
    versions |= {command: shlex.split(command) for command in arguments.against}
    rows = []
    for words in arguments.runs or [f"--preset {preset}" for preset in PRESETS]:
        for version, command in versions.items():
            flags = [*shlex.split(words), *shlex.split(arguments.flags)]
            row = {"version": version, "run": words} | _time_command(command, arguments.data, flags)
            rows.append(row)
            if not arguments.json:
                print(_describe_row(row), flush=True)
    reached = {
        version: {level: find_seconds_to(level, rows, version) for level in arguments.levels}
        for version in versions
    }
    if arguments.json:
        print_json({"runs": rows, "reached": reached})
        return 0
    for version, levels in reached.items():
        for level, seconds in levels.items():
            text = "in {:.1f} s ({:.1f} CPU-s)".format(*seconds) if seconds else "not reached"
            print(f"{version}: {level:g} dB {text}")
    return 0


def _time_command(command: Sequence[str], data: str, flags: Sequence[str]) -> dict[str, Any]:
    """Runs one whole command; returns its figures, its seconds and the curve of its history."""
    with tempfile.TemporaryDirectory(prefix="gsut-bench-") as folder:
        out = Path(folder) / "run"
        words = [*command, "train", data, "-o", str(out), "--quiet", *flags]
        began, before = time.perf_counter(), _measure_child_seconds()
        try:
            done = subprocess.run(words, capture_output=True, encoding="utf-8", check=False)
        except OSError as error:
            raise InputError(f"{command[0]} cannot be run: {error.strerror}") from None
        seconds, cpu_seconds = time.perf_counter() - began, _measure_child_seconds() - before
        if done.returncode:
            said = done.stderr.strip().splitlines()[-1:] or ["it says nothing"]
            reason = said[0].removeprefix("gsut: error: ")
            raise InputError(f"{shlex.join(words)} failed: {reason}")
        run = RunFolder(out)
        metrics, rows = run.read_json(RunFile.METRICS), run.read_history()
    if metrics["psnr"] is None or not metrics["test_views"]:
        raise InputError(f"{data} has no held-out views to measure PSNR on")
    curve = [row for row in rows if row.get("psnr") is not None]
    figures = {key: metrics[key] for key in _FIGURES}
    return {**figures, "seconds": seconds, "cpu_seconds": cpu_seconds, "curve": curve}


def _measure_child_seconds() -> float:
    used = os.times()
    return used.children_user + used.children_system


def find_seconds_to(
    level: float, rows: Sequence[dict[str, Any]], version: str
) -> tuple[float, float] | None:
    """Finds the seconds and processor seconds of a command that reaches a PSNR; None: none does.

    Between two runs by interpolation of their logarithms; those of the first run, at most, where
    it reaches more.
    """
    own = sorted((row for row in rows if row["version"] == version), key=lambda row: row["seconds"])
    for place, high in enumerate(own):
        if high["psnr"] < level:
            continue
        low = own[place - 1] if place else high
        part = (level - low["psnr"]) / (high["psnr"] - low["psnr"]) if place else 1.0
        seconds, cpu_seconds = (
            math.exp((1 - part) * math.log(low[key]) + part * math.log(high[key]))
            for key in ("seconds", "cpu_seconds")
        )
        return seconds, cpu_seconds
    return None


def _describe_row(row: dict[str, Any]) -> str:
    """Returns the row and its curve in words."""
    curve = "".join(
        f"    {point['seconds']:8.1f} s {_describe_cpu(point)}{point['psnr']:7.2f} dB\n"
        for point in row["curve"]
    )
    return (
        f"{row['version']}, {row['run']}, of the steps alone, up to four held-out views:\n{curve}"
        f"    whole: {row['psnr']:.2f} dB, SSIM {row['ssim']:.4f}, {row['num_gaussians']:,} "
        f"Gaussians in {row['seconds']:.1f} s ({row['cpu_seconds']:.1f} CPU-s), of these "
        f"{row['train_seconds']:.1f} s training"
    )


def _describe_cpu(point: dict[str, Any]) -> str:
    cpu = point.get("cpu_seconds")
    return f"{'':14}" if cpu is None else f"{cpu:8.1f} CPU-s"
