"""What a run was made with: versions, machine, command line, memory."""

from __future__ import annotations

import contextlib
import os
import platform
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from gsut import _core
from gsut.files import read_text
from gsut.system import format_command


def describe_environment(dataset: str | os.PathLike[str] | None = None) -> dict[str, Any]:
    """Describes versions, machine and command line, for environment.json.

    Args:
        dataset: the data set's path; kept in full, so that `gsut eval` finds it from anywhere.

    Returns:
        dict of str, int and dict, ready for JSON.
    """
    import cv2

    return {
        "dataset": str(Path(dataset).resolve()) if dataset is not None else None,
        "command": format_command_line(),
        "started": time.strftime("%Y-%m-%d %H:%M:%S %z"),
        "version": _core.__version__,
        "build": _core.describe_build(),
        "isa": _core.active_isa(),
        "threads": _core.num_threads(),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "opencv": cv2.__version__,
        "system": platform.platform(),
        "processor": _read_processor_name(),
        "processors": os.cpu_count(),
    }


def format_command_line() -> str:
    """Returns the command line of this process, without the program's path."""
    program = Path(sys.argv[0]).name if sys.argv and sys.argv[0] else "python"
    return format_command(["gsut" if program == "__main__.py" else program, *sys.argv[1:]])


def measure_peak_rss() -> float | None:
    """Returns the largest resident memory of this process so far, in MiB; None if unknown."""
    with contextlib.suppress(OSError, StopIteration):
        # Of Linux: what getrusage reports starts with that of the parent process.
        status = read_text("/proc/self/status").splitlines()
        return int(next(row for row in status if row.startswith("VmHWM")).split()[1]) / 1024
    try:
        import resource
    except ImportError:  # Windows
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 2**20 if sys.platform == "darwin" else peak / 1024  # bytes there, KiB here


def _read_processor_name() -> str:
    """Returns the processor's name as the system reports it."""
    try:
        for line in read_text("/proc/cpuinfo").splitlines():
            if line.startswith(("model name", "Model")):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()
