"""`./run bench render`: forward, backward and training step, each with its error."""

from __future__ import annotations

import functools
from collections.abc import Iterator

from gsut import _core
from gsut._core import InputError
from tests.bench.accuracy import Errors, Truth, errors_of, make_truth
from tests.bench.harness import WRONG, Benchmark, Column, Option, Row, Settings
from tests.bench.measure import (
    BACKWARD_STAGES,
    FORWARD_STAGES,
    FastRun,
    ScalarRun,
    Times,
    best_times,
    measure_step,
    scalar_baseline,
)
from tests.bench.scenes import KNOWN_SCENES, BenchScene, scene_from_arrays

# Largest errors of a right result against the double reference.
IMAGE_RMS_BOUND = 1e-5  # colours in [0, 1]
GRADIENT_RELATIVE_BOUND = 1e-4  # of the worst parameter's gradient
_SCALAR_REPEATS = 2  # it takes seconds


def list_cases(settings: Settings) -> Iterator[Row]:
    """Lists scenes and instruction sets."""
    available = _core.available_isas()
    wanted = available if settings.isa == ("all",) else settings.isa
    for isa in wanted:
        if isa and isa not in available:
            raise InputError(
                f'instruction set "{isa}" is not available; available: {", ".join(available)}'
            )
    for scene in settings.scenes:
        for isa in wanted:
            yield {"scene": scene, "isa": isa or _core.active_isa()}


def measure(case: Row, settings: Settings) -> Row:
    """Measures one scene with one instruction set."""
    _core.set_isa("")
    scene, truth = _prepare(case["scene"], settings.tiles)
    scalar = _measure_scalar(case["scene"], settings.tiles, _core.num_threads())
    _core.set_isa(case["isa"])
    run = FastRun(scene, _core.BlendRule())
    run.once(truth.dimage)
    errors = errors_of(truth, run.image, run.gradients)
    times = best_times(run.once, settings.runs)
    step = measure_step(scene, settings.steps)
    row = {
        "threads": _core.num_threads(),
        "num_gaussians": len(scene.gaussians),
        "pairs_per_pixel": truth.pairs_per_pixel,
        "forward_ms": times.wall_ms(*FORWARD_STAGES),
        "blend_ms": times.cpu_ms("forward"),
        "backward_ms": times.wall_ms(*BACKWARD_STAGES),
        "tiles_ms": times.cpu_ms("backward"),
        "step_ms": step.wall_ms("step"),
        "step_cpu_ms": step.cpu_ms("step"),
        "blend_speedup": scalar and scalar.cpu_ms("forward") / times.cpu_ms("forward"),
        "tiles_speedup": scalar and scalar.cpu_ms("backward") / times.cpu_ms("backward"),
        "bytes_per_gaussian": run.renderer.statistics()["buffer_bytes"] / len(scene.gaussians),
        "image_rms_error": errors.image_rms,
        "gradient_error": errors.gradient_relative,
    }
    return row | _find_wrong(errors)


def _find_wrong(errors: Errors) -> Row:
    gradients = errors.gradient_relative
    if errors.image_rms <= IMAGE_RMS_BOUND and (gradients or 1.0) <= GRADIENT_RELATIVE_BOUND:
        return {}
    return {
        WRONG: "no times: the errors are out of bounds",
        "blend_speedup": None,
        "tiles_speedup": None,
    }


@functools.lru_cache(maxsize=1)
def _prepare(name: str, tiles: int) -> tuple[BenchScene, Truth]:
    scene = scene_from_arrays(name)
    return scene, make_truth(scene, _core.BlendRule(), tiles=tiles)


@functools.lru_cache(maxsize=1)
def _measure_scalar(name: str, tiles: int, threads: int) -> Times | None:
    """Times of the scalar baseline, which knows one pose a picture only."""
    scene, truth = _prepare(name, tiles)
    if scalar_baseline is None or isinstance(scene.camera_from_world, _core.CameraMotion):
        return None
    run = ScalarRun(scene, _core.BlendRule())
    run.once(truth.dimage)
    return best_times(run.once, _SCALAR_REPEATS, warmups=0)


BENCHMARK = Benchmark(
    help="forward, backward and training step beside their errors against the double reference",
    columns=(
        Column("scene"),
        Column("isa", "instructions"),
        Column("threads", form="d"),
        Column("num_gaussians", "Gaussians", form=",d"),
        Column("pairs_per_pixel", "blended per pixel", form=".1f"),
        Column("forward_ms", "forward", "ms", ".1f"),
        Column("blend_ms", "blend", "CPU-ms", ".1f"),
        Column("blend_speedup", "blend, x scalar", form=".0f"),
        Column("backward_ms", "backward", "ms", ".1f"),
        Column("tiles_ms", "backward of tiles", "CPU-ms", ".1f"),
        Column("tiles_speedup", "tiles, x scalar", form=".0f"),
        Column("step_ms", "training step", "ms", ".1f"),
        Column("step_cpu_ms", "training step", "CPU-ms", ".1f"),
        Column("bytes_per_gaussian", "buffers", "bytes per Gaussian", ",.0f"),
        Column("image_rms_error", "image rms error", form=".1e"),
        Column("gradient_error", "gradient error", form=".1e"),
    ),
    cases=list_cases,
    measure=measure,
    options=(
        Option(
            "scenes", KNOWN_SCENES[:2] + KNOWN_SCENES[3:5], f"{', '.join(KNOWN_SCENES)}, or alike"
        ),
        Option("isa", ("",), "instruction sets, or all; empty: the best one"),
        Option("runs", 20, "runs, of which the fastest counts"),
        Option("steps", 10, "training steps, of which the fastest counts"),
        Option("tiles", 32, "random tiles whose errors are measured"),
    ),
)
