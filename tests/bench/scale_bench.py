"""`./run bench scale`: time and memory from 10 k to 10 M Gaussians, 0.1 to 8 megapixels.

Each size is measured in a process of its own (this module run as a script), so that one size's
memory is not counted to the next, and running out of memory ends one size only.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.run import free_memory, peak_rss_mb
from tests.bench.measure import BACKWARD_STAGES, FORWARD_STAGES, step_loop, step_times
from tests.bench.plots import plot_scale
from tests.bench.report_rows import add_files, bar, check_files, numbers, print_and_write, words
from tests.bench.scenes import dense_sigma_pixels, parsed_count, synthetic_scene

DEFAULT_COUNTS = (10_000, 100_000, 1_000_000)
DEFAULT_MEGAPIXELS = (0.1, 0.3, 1.0, 2.0, 8.0)
_ASPECT = 4 / 3
# What a size may need at most, bytes: it is left out if the machine has not so much to spare.
# (About 1450 a Gaussian were seen while the scene is handed to the optimiser.)
_BYTES_PER_GAUSSIAN, _BYTES_PER_PIXEL, _BYTES_FIXED = 1550, 300, 300_000_000
_RESERVE_BYTES = 2_000_000_000

SCALE_COLUMNS = (
    ("Gaussians", "num_gaussians", ",d"),
    ("width", "width", "d"),
    ("height", "height", "d"),
    ("thr", "threads", "d"),
    ("tile pairs", "tile_pairs", ",d"),
    ("forward ms", "forward_ms", ".1f"),
    ("cpu", "forward_cpu_ms", ".1f"),
    ("backward ms", "backward_ms", ".1f"),
    ("cpu", "backward_cpu_ms", ".1f"),
    ("step ms", "step_ms", ".1f"),
    ("cpu", "step_cpu_ms", ".1f"),
    ("x linear", "step_over_linear", ".2f"),
    ("peak MB", "peak_mb", ",.0f"),
    ("buffer B/Gaussian", "bytes_per_gaussian", ",.0f"),
    ("", "note", ""),
)


@dataclasses.dataclass(frozen=True)
class ScaleOptions:
    """Sizes to measure.

    Args:
        counts: numbers of Gaussians.
        megapixels: of the images, 4 : 3.
        threads: 0 = all processors.
        steps: training steps timed at each size.
    """

    counts: Sequence[int] = DEFAULT_COUNTS
    megapixels: Sequence[float] = DEFAULT_MEGAPIXELS
    threads: int = 0
    steps: int = 5


def image_size(megapixels: float) -> tuple[int, int]:
    """Width and height of about so many megapixels, multiples of 16."""
    width = max(1, round((megapixels * 1e6 * _ASPECT) ** 0.5 / 16)) * 16
    return width, max(1, round(width / _ASPECT / 16)) * 16


def scale_bench(
    options: ScaleOptions, on_progress: Callable[[str], None] = lambda text: None
) -> list[dict[str, Any]]:
    """Measures every number of Gaussians on every image size, small ones first.

    The scene is the synthetic one, with sizes such that about 50 Gaussians are blended a pixel at
    any number of them.

    Args:
        options: the sizes.
        on_progress: gets a word before each.

    Returns:
        One row a size: times of forward, backward and step (ms, the shortest; processor time over
        threads, too), tile pairs, peak memory of the process, and `step_over_linear`: the step's
        processor time over a fit a x Gaussians + b x pixels to all sizes. A size that the machine's
        memory does not hold has null times and says so in `note`.

    Raises:
        InputError: a number out of range.
    """
    if not options.counts or not options.megapixels or min(options.counts) < 1:
        raise InputError("the scale needs numbers of Gaussians and image sizes above 0")
    if min(options.megapixels) <= 0 or options.steps < 1 or options.threads < 0:
        raise InputError("megapixels must be above 0, steps at least 1, threads at least 0")
    rows = []
    for count in sorted(options.counts):
        for megapixels in sorted(options.megapixels):
            width, height = image_size(megapixels)
            on_progress(f"{count:,} Gaussians on {width} x {height}")
            rows.append(_measured_apart(count, width, height, options))
    add_linear_fit(rows)
    return rows


def add_linear_fit(rows: Sequence[dict[str, Any]]) -> tuple[float, float]:
    """Fits step time = a N + b P to the rows and writes `step_over_linear` into them.

    The fit minimises relative errors, so small sizes count as much as large ones.

    Returns:
        a, b: milliseconds of processor time over threads a Gaussian and a pixel; NaN without two
        measured rows.
    """
    measured = [row for row in rows if row["step_cpu_ms"]]
    for row in rows:
        row["step_over_linear"] = None
    if len(measured) < 2:
        return float("nan"), float("nan")
    size = np.array([[row["num_gaussians"], row["width"] * row["height"]] for row in measured])
    time = np.array([row["step_cpu_ms"] for row in measured])
    (a, b), *_ = np.linalg.lstsq(size / time[:, None], np.ones(len(time)), rcond=None)
    for row, fit in zip(measured, size @ (a, b), strict=True):
        row["step_over_linear"] = float(row["step_cpu_ms"] / fit)
    return float(a), float(b)


def _measured_apart(count: int, width: int, height: int, options: ScaleOptions) -> dict[str, Any]:
    row: dict[str, Any] = {
        "name": f"scale_{count}_{width}x{height}", "isa": _core.active_isa(),
        "threads": options.threads, "num_gaussians": count, "width": width, "height": height,
        "note": "",
    }  # fmt: skip
    row |= dict.fromkeys(_MEASURED)
    needed = _BYTES_PER_GAUSSIAN * count + _BYTES_PER_PIXEL * width * height + _BYTES_FIXED
    available = free_memory()
    if available is not None and needed + _RESERVE_BYTES > available:
        row["note"] = (
            f"left out: may need {needed / 1e9:.1f} GB, {available / 1e9:.1f} GB are available"
        )
        return row
    command = [
        sys.executable, "-m", "tests.bench.scale_bench", str(count), str(width), str(height),
        str(options.threads), str(options.steps),
    ]  # fmt: skip
    environment = os.environ | {"GSUT_ISA": _core.active_isa()}
    package = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
    environment["PYTHONPATH"] = os.pathsep.join(
        [package, *filter(None, [os.environ.get("PYTHONPATH")])]
    )
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    if done.returncode != 0:
        reason = done.stderr.strip().splitlines()[-1:] or [f"exit status {done.returncode}"]
        row["note"] = f"failed: {reason[0]}"
        return row
    return row | json.loads(done.stdout)


_MEASURED = (
    "tile_pairs", "contributing_tile_pairs", "forward_ms", "forward_cpu_ms", "backward_ms",
    "backward_cpu_ms", "step_ms", "step_cpu_ms", "peak_mb", "bytes_per_gaussian", "stages",
)  # fmt: skip


def _measure(count: int, width: int, height: int, threads: int, steps: int) -> dict[str, Any]:
    """One size, in this process."""
    _core.set_num_threads(threads)
    sigma = dense_sigma_pixels(count, width, height)
    loop = step_loop(synthetic_scene(count, width, height, sigma_pixels=sigma), steps)
    times = step_times(loop, steps)
    statistics = loop.renderer.statistics()
    return {
        "threads": _core.num_threads(),
        "tile_pairs": statistics["num_pairs"],
        "contributing_tile_pairs": statistics["num_contributing_pairs"],
        "forward_ms": times.wall_ms(*FORWARD_STAGES),
        "forward_cpu_ms": times.cpu_ms(*FORWARD_STAGES),
        "backward_ms": times.wall_ms(*BACKWARD_STAGES),
        "backward_cpu_ms": times.cpu_ms(*BACKWARD_STAGES),
        "step_ms": times.wall_ms("step"),
        "step_cpu_ms": times.cpu_ms("step"),
        "peak_mb": peak_rss_mb(),
        "bytes_per_gaussian": statistics["buffer_bytes"] / count,
        "stages": times.per_stage_ms(),
    }


# --- the command ----------------------------------------------------------------------------------

HELP = "time and memory of forward, backward and step over numbers of Gaussians and image sizes"


def add_flags(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("--counts", metavar="N,M", help="Gaussians [default 10k,100k,1m]")
    add("--megapixels", metavar="X,Y", help="image sizes [default 0.1,0.3,1,2,8]")
    add("--isa", metavar="NAME", help="instruction set [default: the best]")
    add("--threads", type=int, default=0, metavar="N", help="0 = all [default 0]")
    add("--steps", type=int, default=5, metavar="N", help="training steps timed [default 5]")
    add_files(parser, "time and memory")


def run(arguments: argparse.Namespace) -> int:
    check_files(arguments)
    options = ScaleOptions(
        counts=[parsed_count(word) for word in words(arguments.counts)] or DEFAULT_COUNTS,
        megapixels=numbers(arguments.megapixels, float, "--megapixels") or DEFAULT_MEGAPIXELS,
        threads=arguments.threads,
        steps=arguments.steps,
    )
    before = _core.active_isa()
    if arguments.isa:
        _core.set_isa(arguments.isa)
    try:
        with bar(len(options.counts) * len(options.megapixels)) as advance:
            rows = scale_bench(options, advance)
    finally:
        _core.set_isa(before)
    print_and_write(rows, SCALE_COLUMNS, arguments)
    per_gaussian, per_pixel = add_linear_fit(rows)
    print(
        f"step = {1e6 * per_gaussian:.0f} ns a Gaussian + {1e6 * per_pixel:.0f} ns a pixel "
        "(processor time / threads)"
    )
    if arguments.plot:
        plot_scale(arguments.plot, rows)
    return 0


if __name__ == "__main__":
    print(json.dumps(_measure(*(int(word) for word in sys.argv[1:]))))
