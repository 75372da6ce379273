"""`./run bench cores`: a gsut command on 1, 2, 4 ... processors, and a forecast for 8 and 16."""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from gsut._core import InputError
from gsut.files import write_json
from tests.bench.trace_command import CORES, Trace

HELP = "a gsut command on 1, 2, 4 ... processors, and a forecast for 8 and 16 from a trace"
_RUNS = (1, *CORES)  # numbers of processors that it runs on, as far as there are so many
_FORECAST = (2, 8, 16)
_SHOWN = 8  # places listed


def add_flags(parser: argparse.ArgumentParser) -> None:
    """Adds the command's words and the flags."""
    parser.add_argument("--json", metavar="FILE", help="file for the figures")
    parser.add_argument("--trace-only", action="store_true", help="do not time the command")
    parser.add_argument(
        "words", nargs=argparse.REMAINDER, metavar="WORD",
        help="of the command, OUT for what it writes: train DATA -o OUT --preset fast",
    )  # fmt: skip


def run(arguments: argparse.Namespace) -> int:
    """Times and traces the command, and prints what was found."""
    words = [word for word in arguments.words if word != "--"]
    if not words or "OUT" not in words:
        raise InputError("give a gsut command with OUT for what it writes: train DATA -o OUT")
    processors = sorted(getattr(os, "sched_getaffinity", lambda _: ())(0))
    if len(processors) < 2:
        raise InputError("this needs a system that binds processes to processors, and two of them")
    runs = []
    if not arguments.trace_only:
        for count in _RUNS:
            if count <= len(processors):
                print(f"running on {count} ...", file=sys.stderr)
                runs.append({"processors": count} | time_command(words, processors[:count]))
    print("tracing ...", file=sys.stderr)
    figures = {"words": words, "runs": runs, "trace": read_trace(words)}
    print("\n".join(describe(figures)))
    if arguments.json:
        write_json(arguments.json, figures)
    return 0


def _run_in_folder(command: Sequence[str], words: Sequence[str], **how: Any) -> None:
    """Runs a command with OUT replaced by a new name in a folder that goes afterwards.

    Raises:
        InputError: it fails; its last line.
    """
    with tempfile.TemporaryDirectory(prefix="gsut-cores-") as folder:
        own = [os.path.join(folder, "out") if word == "OUT" else word for word in words]
        # Modules are read compiled, as those of an installed package.
        compiled = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
        compiled["PYTHONPYCACHEPREFIX"] = os.path.join(tempfile.gettempdir(), "gsut-cores-code")
        done = subprocess.run(
            [*command, *own], env=compiled, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
            text=True, check=False, **how,
        )  # fmt: skip
    if done.returncode:
        last = done.stderr.strip().splitlines()[-1:] or [f"exit status {done.returncode}"]
        raise InputError(f"gsut {' '.join(words)}: {last[0]}")


def time_command(words: Sequence[str], processors: Sequence[int]) -> dict[str, float]:
    """Runs the command on these processors alone: `seconds` and `cpu_seconds`."""
    before, began = os.times(), time.perf_counter()
    bind = lambda: os.sched_setaffinity(0, processors)  # noqa: E731
    _run_in_folder([sys.executable, "-m", "gsut"], words, preexec_fn=bind)
    after = os.times()
    used = after.children_user - before.children_user
    used += after.children_system - before.children_system
    return {"seconds": time.perf_counter() - began, "cpu_seconds": used}


def read_trace(words: Sequence[str]) -> dict[str, Any]:
    """Runs the command once more and returns its `Trace` as JSON values."""
    with tempfile.TemporaryDirectory(prefix="gsut-trace-") as folder:
        file = Path(folder) / "trace.json"
        _run_in_folder([sys.executable, "-m", "tests.bench.trace_command", str(file)], words)
        return json.loads(file.read_text())


def read_values(values: dict[str, Any]) -> Trace:
    """Returns the trace of JSON values."""
    return Trace(**values | {"parallel": {int(k): v for k, v in values["parallel"].items()}})


def describe(figures: dict[str, Any]) -> list[str]:
    """Describes times, forecast and the places that use one core."""
    trace, runs = read_values(figures["trace"]), figures["runs"]
    lines = [f"gsut {' '.join(figures['words'])}", ""]
    lines.append("| Processors | time [s] | time [CPU-s] | forecast [s] | efficiency |")
    lines.append("|" + "---|" * 5)
    took = {row["processors"]: row for row in runs}
    for cores in sorted({*took, 1, *_FORECAST}):
        row, forecast = took.get(cores), trace.forecast(cores)
        found = [f"{row[key]:.1f}" if row else "-" for key in ("seconds", "cpu_seconds")]
        share = trace.seconds / forecast / cores
        lines.append(f"| {cores} | {' | '.join(found)} | {forecast:.1f} | {share:.0%} |")
    if 1 in took and 2 in took:
        faster = took[1]["seconds"] / took[2]["seconds"]
        more = took[2]["cpu_seconds"] / took[1]["cpu_seconds"]
        lines += [
            "",
            f"Two processors: {faster:.2f} times as fast, "
            f"{trace.seconds / trace.forecast(2):.2f} by the trace; processor time {more:.2f} "
            "times that on one, which the forecast leaves out.",
        ]
    return [
        *lines,
        "",
        f"Of {trace.seconds:.1f} CPU-s on one thread {trace.serial:.1f} are serial, "
        f"{trace.background:.1f} run beside the main thread, {trace.few_chunks:.1f} in loops of "
        f"fewer than 8 chunks; the longest chunks of all loops take {trace.longest_chunks:.1f}.",
        "",
        *_describe_places("Serial, in", trace.places),
        "",
        *_describe_places("Lost in loops on 8 cores, in", trace.lost),
    ]


def _describe_places(heading: str, places: Sequence[tuple[str, float]]) -> list[str]:
    rows = [f"| {place} | {seconds:.2f} |" for place, seconds in places[:_SHOWN]]
    return [f"| {heading} | CPU-s |", "|---|---|", *rows]
