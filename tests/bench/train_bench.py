"""`./run bench train`: PSNR against seconds of each preset, and where a step's time goes."""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.evaluate import mean_psnr
from gsut.run import (
    PRESETS,
    Progress,
    TrainOptions,
    add_option_flags,
    check_options,
    describe_options,
    given_options,
    option,
)
from tests.bench.plots import plot_curves
from tests.bench.report_rows import MEASURED, add_files, check_files, print_and_write, table_text

# Whole dB at which the time to quality is told, where a run passes them.
_MILESTONES_DB = range(20, 45)
_FIRST_MEASUREMENT = 0.02  # of the steps
STAGES = (
    "project", "records", "bin", "forward", "loss", "backward", "gradients", "statistics", "adam",
    "noise", "densify", "other",
)  # fmt: skip

TRAIN_COLUMNS = (
    ("preset", "preset", ""),
    ("isa", "isa", ""),
    ("thr", "threads", "d"),
    ("steps", "steps", "d"),
    ("Gaussians", "num_gaussians", ",d"),
    ("load s", "load_seconds", ".1f"),
    ("seconds", "seconds", ".1f"),
    ("cpu s", "cpu_seconds", ".1f"),
    ("PSNR dB", "psnr", ".2f"),
    ("step ms", "step_ms", ".1f"),
    ("cpu", "step_cpu_ms", ".1f"),
)
CURVE_COLUMNS = (
    ("preset", "preset", ""),
    ("step", "step", "d"),
    ("Gaussians", "num_gaussians", ",d"),
    ("seconds", "seconds", ".2f"),
    ("cpu s", "cpu_seconds", ".2f"),
    ("PSNR dB", "psnr", ".2f"),
)


@describe_options
@dataclasses.dataclass(frozen=True)
class TrainBenchOptions:
    """What to train on the dataset `data`, which has held-out views.

    Raises:
        InputError: a value of the wrong kind or out of range.
    """

    data: str
    preset: tuple[str, ...] = option(tuple(PRESETS), MEASURED, "presets of gsut train")
    measurements: int = option(12, MEASURED, "points of each curve", low=2)
    scale: float = option(1.0, MEASURED, "of the images", low=0, high=1, low_open=True)
    threads: int = option(0, MEASURED, "0 = all", low=0)
    steps: int | None = option(None, MEASURED, "training steps", low=1, none="the preset's")

    def __post_init__(self) -> None:
        check_options(self)


def train_bench(
    options: TrainBenchOptions,
    on_step: Callable[[dict[str, Any]], None] = lambda state: None,
) -> list[dict[str, Any]]:
    """Trains with each preset from the dataset on disk.

    Seconds count from the beginning of loading the dataset, everything but the measuring of PSNR
    included: reading and shrinking images, first Gaussians, all steps.

    Args:
        options: what to train.
        on_step: called after each step with a dict preset, step, steps, loss, num_gaussians, psnr
            (the last one measured, or None).

    Returns:
        One row a preset: seconds, processor seconds, PSNR (mean over all held-out views, inside
        their masks), mean times of a step and its stages in milliseconds (processor time over
        threads, too), `seconds_to_db` (whole dB -> seconds, by linear interpolation of the curve)
        and `curve`, a list of dict preset, step, seconds, cpu_seconds, num_gaussians, psnr.

    Raises:
        InputError: an unknown preset, a dataset without held-out views, or a bad option.
    """
    unknown = [preset for preset in options.preset if preset not in PRESETS]
    if unknown:
        raise InputError(f'preset "{unknown[0]}" is unknown; known: {", ".join(PRESETS)}')
    before = _core.num_threads()
    try:
        return [_train_one(preset, options, on_step) for preset in options.preset]
    finally:
        _core.set_num_threads(before)


def _train_one(
    preset: str, options: TrainBenchOptions, on_step: Callable[[dict[str, Any]], None]
) -> dict[str, Any]:
    import gsut
    from gsut.training import TrainingLoop

    o = TrainOptions(
        preset=preset, threads=options.threads, eval_every=0, steps=options.steps
    ).resolved()
    _core.set_num_threads(o.threads)
    clock = _PausedClock()
    scene = gsut.load_dataset(options.data, scale=options.scale)
    if not scene.test_indices:
        raise InputError(f"{options.data} has no held-out views to measure PSNR on")
    loop = TrainingLoop(scene, o)
    load_seconds = clock.seconds()[0]
    curve: list[dict[str, Any]] = []
    measure_at = set(_measured_steps(o.steps, options.measurements))
    stages = dict.fromkeys(STAGES, (0.0, 0.0))
    while loop.step < o.steps:
        loss = loop.advance()
        _add(stages, loop.renderer.timings())
        if loop.step in measure_at:
            wall, cpu = clock.seconds()
            with clock.paused():
                found = mean_psnr(
                    loop.scene, loop.make_result(), scene.test_indices, o.background,
                    light=loop.photographs.find_light(),
                )  # fmt: skip
                curve.append({
                    "preset": preset, "step": loop.step, "seconds": wall, "cpu_seconds": cpu,
                    "num_gaussians": len(loop.gaussians), "psnr": found,
                })  # fmt: skip
        on_step({
            "preset": preset, "step": loop.step, "steps": o.steps, "loss": loss,
            "num_gaussians": len(loop.gaussians), "psnr": curve[-1]["psnr"] if curve else None,
        })  # fmt: skip
    return _row(preset, scene, loop, stages, curve, load_seconds)


def _row(
    preset: str,
    scene: Any,
    loop: Any,
    stages: dict[str, tuple[float, float]],
    curve: list[dict[str, Any]],
    load_seconds: float,
) -> dict[str, Any]:
    """What is written down of one run. stages: the renderer's; the loop's are added."""
    outer = {name: tuple(times) for name, times in loop.stopwatch.seconds.items()}
    whole = np.sum(list(outer.values()), axis=0)
    _add(stages, {name: t for name, t in outer.items() if name not in ("render", "backward")})
    # What render and backward take beside the renderer's own stages.
    stages["other"] = tuple(whole - np.sum(list(stages.values()), axis=0))
    threads, steps = _core.num_threads(), loop.step
    camera, last = scene.cameras[0], curve[-1]
    return {
        "name": f"{Path(scene.path).name}_{preset}", "preset": preset, "isa": _core.active_isa(),
        "threads": threads, "steps": steps, "num_gaussians": last["num_gaussians"],
        "width": camera.width, "height": camera.height, "load_seconds": load_seconds,
        "seconds": last["seconds"], "cpu_seconds": last["cpu_seconds"], "psnr": last["psnr"],
        "step_ms": 1e3 * whole[0] / steps, "step_cpu_ms": 1e3 * whole[1] / steps / threads,
        "stages": {
            name: {"wall_ms": 1e3 * wall / steps, "cpu_ms": 1e3 * cpu / steps / threads}
            for name, (wall, cpu) in stages.items()
        },
        "seconds_to_db": seconds_to_db(curve), "curve": curve,
    }  # fmt: skip


def seconds_to_db(curve: Sequence[dict[str, Any]]) -> dict[str, float]:
    """When each whole dB was first passed, by linear interpolation; from the curve's first on."""
    passed: dict[str, float] = {}
    for low, high in itertools.pairwise(curve):
        for level in _MILESTONES_DB:
            if low["psnr"] < level <= high["psnr"] and str(level) not in passed:
                part = (level - low["psnr"]) / (high["psnr"] - low["psnr"])
                passed[str(level)] = low["seconds"] + part * (high["seconds"] - low["seconds"])
    return passed


def stage_rows(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """One row a stage with the presets as columns: processor milliseconds a step over threads."""
    return [
        {"stage": stage} | {row["preset"]: row["stages"][stage]["cpu_ms"] for row in rows}
        for stage in STAGES
    ]


def _measured_steps(steps: int, count: int) -> list[int]:
    """Steps in geometric progression up to the last."""
    first = max(1, round(_FIRST_MEASUREMENT * steps))
    return sorted({round(step) for step in np.geomspace(first, steps, count)} | {steps})


def _add(sums: dict[str, tuple[float, float]], times: dict[str, tuple[float, float]]) -> None:
    for stage, (wall, cpu) in times.items():
        old = sums.get(stage, (0.0, 0.0))
        sums[stage] = (old[0] + wall, old[1] + cpu)


class _PausedClock:
    """Wall and processor seconds since it was made, but for the pauses."""

    def __init__(self) -> None:
        self._begun = time.perf_counter(), time.process_time()
        self._entered = self._begun

    def seconds(self) -> tuple[float, float]:
        return time.perf_counter() - self._begun[0], time.process_time() - self._begun[1]

    def paused(self) -> _PausedClock:
        return self

    def __enter__(self) -> None:
        self._entered = time.perf_counter(), time.process_time()

    def __exit__(self, *_: object) -> None:
        now = time.perf_counter(), time.process_time()
        wall, cpu = (
            begun + end - start
            for begun, start, end in zip(self._begun, self._entered, now, strict=True)
        )
        self._begun = wall, cpu


# --- the command ----------------------------------------------------------------------------------

HELP = "held-out PSNR against seconds of each preset, from the reading of the dataset on"


def add_flags(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("data", metavar="DATA", help="dataset with held-out views")
    add_option_flags(parser, TrainBenchOptions)
    add_files(parser, "PSNR against seconds")


def run(arguments: argparse.Namespace) -> int:
    check_files(arguments)
    options = TrainBenchOptions(arguments.data, **given_options(TrainBenchOptions, arguments))
    with Progress() as bars:

        def on_step(state: dict[str, Any]) -> None:
            figures = state["loss"], state["num_gaussians"], state["psnr"]
            bars.show_step(state["step"], state["steps"], *figures)

        rows = train_bench(options, on_step)
    print(table_text([point for row in rows for point in row["curve"]], CURVE_COLUMNS))
    print()
    print_and_write(rows, TRAIN_COLUMNS, arguments)
    print("\nmilliseconds a step by stage (processor time / threads)")
    columns = (("stage", "stage", ""), *((row["preset"], row["preset"], ".2f") for row in rows))
    print(table_text(stage_rows(rows), columns))
    for row in rows:
        passed = ", ".join(f"{level} dB in {s:.1f} s" for level, s in row["seconds_to_db"].items())
        print(f"{row['preset']}: {passed or 'no whole dB passed between two measurements'}")
    if arguments.plot:
        plot_curves(arguments.plot, {row["preset"]: row["curve"] for row in rows})
    return 0
