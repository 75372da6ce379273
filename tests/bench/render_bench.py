"""`./run bench render`: forward, backward and training step, each with its error."""

from __future__ import annotations

import argparse
import dataclasses
import os
from collections.abc import Callable, Sequence
from typing import Any

from gsut import _core
from gsut._core import InputError
from gsut.run import add_option_flags, check_options, describe_options, given_options, option
from tests.bench.accuracy import Errors, Truth, errors_of, make_truth
from tests.bench.knobs import KNOB_COLUMNS, knob_bench, knob_settings
from tests.bench.measure import (
    BACKWARD_STAGES,
    FORWARD_STAGES,
    SCALAR_FORWARD_STAGES,
    FastRun,
    ScalarRun,
    Times,
    best_times,
    measure_step,
    scalar_baseline,
)
from tests.bench.plots import plot_knobs
from tests.bench.report_rows import (
    MEASURED,
    add_files,
    bar,
    check_files,
    print_and_write,
    table_text,
)
from tests.bench.scenes import KNOWN_SCENES, BenchScene, make_scene

RENDER_COLUMNS = (
    ("scene", "name", ""),
    ("isa", "isa", ""),
    ("thr", "threads", "d"),
    ("pairs/px", "pairs_per_pixel", ".1f"),
    ("forward ms", "forward_ms", ".1f"),
    ("blend ms", "blend_ms", ".1f"),
    ("cpu", "blend_cpu_ms", ".1f"),
    ("x scalar", "blend_cpu_speedup", ".0f"),
    ("backward ms", "backward_ms", ".1f"),
    ("tiles ms", "backward_tiles_ms", ".1f"),
    ("cpu", "backward_tiles_cpu_ms", ".1f"),
    ("x scalar", "backward_tiles_cpu_speedup", ".0f"),
    ("step ms", "step_ms", ".1f"),
    ("cpu", "step_cpu_ms", ".1f"),
    ("image rms", "image_rms_error", ".1e"),
    ("gradients", "gradient_relative_error", ".1e"),
)


# Bounds of a right result, against the double reference.
IMAGE_RMS_BOUND = 1e-5
GRADIENT_RELATIVE_BOUND = 1e-4
DEFAULT_SCENES = KNOWN_SCENES[:2] + KNOWN_SCENES[3:5]
# Keys of a row that are times or follow from times: null where the result is wrong.
_TIMED = (
    "forward_ms", "backward_ms", "step_ms", "forward_speedup", "backward_speedup", "blend_ms",
    "backward_tiles_ms", "blend_speedup", "backward_tiles_speedup", "forward_cpu_ms",
    "backward_cpu_ms", "blend_cpu_ms", "backward_tiles_cpu_ms", "step_cpu_ms",
    "forward_backward_cpu_s", "blend_cpu_speedup", "backward_tiles_cpu_speedup",
    "mpairs_per_second_per_core", "stages", "step_stages",
)  # fmt: skip


@describe_options
@dataclasses.dataclass(frozen=True)
class RenderBenchOptions:
    """What to measure.

    Raises:
        InputError: a value of the wrong kind or out of range.
    """

    scenes: tuple[str, ...] = option(
        DEFAULT_SCENES, MEASURED, f"{', '.join(KNOWN_SCENES)}, or alike with other numbers"
    )
    isa: tuple[str, ...] = option((), MEASURED, "instruction sets; none: all there are")
    threads: tuple[int, ...] = option((0,), MEASURED, "numbers of threads; 0 = all", low=0)
    repeats: int = option(20, MEASURED, "runs, of which the shortest counts", low=1)
    scalar_repeats: int = option(2, MEASURED, "of the scalar baseline; 0: none", low=0)
    steps: int = option(10, MEASURED, "training steps timed; 0: none", low=0)
    tiles: int = option(32, MEASURED, "random tiles to measure errors on", low=1)
    ply: str | None = option(None, MEASURED, "Gaussians of the scene trained", none="none")
    data: str | None = option(
        None, MEASURED, "dataset of the scene trained", none="the demo scene, trained shortly"
    )

    def __post_init__(self) -> None:
        check_options(self)


def render_bench(
    options: RenderBenchOptions,
    on_progress: Callable[[str], None] = lambda text: None,
) -> list[dict[str, Any]]:
    """Measures all combinations of scene, number of threads and instruction set.

    Args:
        options: what to measure.
        on_progress: gets a word on each measurement before it begins; there are
            `num_measurements(options)` of them.

    Returns:
        One row a combination; times in milliseconds, the shortest of the repeats; null where they
        were not measured or the result is wrong. See tests/bench/README.md for the keys.

    Raises:
        InputError: unknown scene or instruction set.
    """
    isas = checked_isas(options.isa)
    rule = _core.BlendRule()
    before = _core.num_threads(), _core.active_isa()
    rows = []
    try:
        for name in options.scenes:
            on_progress(f"{name}: double reference")
            scene = make_scene(name, ply=options.ply, data=options.data)
            truth = make_truth(scene, rule, tiles=options.tiles)
            for threads in options.threads:
                _core.set_num_threads(threads)
                _core.set_isa("")
                scalar = None
                # The scalar baseline knows one pose a picture only.
                if options.scalar_repeats and not isinstance(
                    scene.camera_from_world, _core.CameraMotion
                ):
                    on_progress(f"{name}: scalar baseline, {_core.num_threads()} threads")
                    scalar = _measure_scalar(scene, rule, truth, options.scalar_repeats)
                for isa in isas:
                    on_progress(f"{name}: {isa}, {_core.num_threads()} threads")
                    _core.set_isa(isa)
                    rows.append(_row(scene, rule, truth, scalar, options))
    finally:
        _core.set_num_threads(before[0])
        _core.set_isa(before[1])
    return rows


def num_measurements(options: RenderBenchOptions) -> int:
    """How often `render_bench` calls on_progress."""
    isas = len(checked_isas(options.isa))
    each = [
        isas + bool(options.scalar_repeats and not name.startswith("rolling_shutter"))
        for name in options.scenes
    ]
    return sum(1 + len(options.threads) * count for count in each)


def checked_isas(isas: Sequence[str]) -> list[str]:
    """The named instruction sets; all of this machine if none is named.

    Raises:
        InputError: one is not there; lists those that are.
    """
    available = _core.available_isas()
    unknown = [isa for isa in isas if isa not in available]
    if unknown:
        raise InputError(
            f'instruction set "{unknown[0]}" is not available; available: {", ".join(available)}'
        )
    return list(isas) or available


@dataclasses.dataclass
class _Scalar:
    """What was measured of the scalar baseline."""

    times: Times
    errors: Errors
    statistics: dict[str, int]


def _measure_scalar(
    scene: BenchScene, rule: _core.BlendRule, truth: Truth, repeats: int
) -> _Scalar:
    run = ScalarRun(scene, rule)
    run.once(truth.dimage)  # warms up, too
    errors = errors_of(truth, run.image, run.gradients)
    return _Scalar(best_times(run.once, repeats, warmups=0), errors, run.renderer.statistics())


def _row(
    scene: BenchScene,
    rule: _core.BlendRule,
    truth: Truth,
    scalar: _Scalar | None,
    options: RenderBenchOptions,
) -> dict[str, Any]:
    """One row: the active instruction set on the active number of threads."""
    run = FastRun(scene, rule)
    run.once(truth.dimage)
    errors = errors_of(truth, run.image, run.gradients)
    times = best_times(run.once, options.repeats)
    step = measure_step(scene, options.steps) if options.steps else None
    count, camera = len(scene.gaussians), scene.camera
    pixels = camera.width * camera.height
    statistics = run.renderer.statistics()
    pairs = truth.pairs_per_pixel if scalar is None else scalar.statistics["num_blended"] / pixels
    row: dict[str, Any] = {
        "name": scene.name,
        "isa": _core.active_isa(),
        "threads": _core.num_threads(),
        "num_gaussians": count,
        "width": camera.width,
        "height": camera.height,
        "pairs_per_pixel": pairs,
        "forward_ms": times.wall_ms(*FORWARD_STAGES),
        "backward_ms": times.wall_ms(*BACKWARD_STAGES),
        "step_ms": None if step is None else step.wall_ms("step"),
        **_scalar_times(scalar),
        "forward_speedup": None,
        "backward_speedup": None,
        "image_rms_error": errors.image_rms,
        "gradient_relative_error": errors.gradient_relative,
        "valid": errors.image_rms <= IMAGE_RMS_BOUND
        and errors.gradient_relative is not None
        and errors.gradient_relative <= GRADIENT_RELATIVE_BOUND,
        # The blend alone and the tiles' backward alone.
        "blend_ms": times.wall_ms("forward"),
        "backward_tiles_ms": times.wall_ms("backward"),
        "blend_speedup": None,
        "backward_tiles_speedup": None,
        # Processor time over threads: the same on a busy machine.
        "forward_cpu_ms": times.cpu_ms(*FORWARD_STAGES),
        "backward_cpu_ms": times.cpu_ms(*BACKWARD_STAGES),
        "blend_cpu_ms": times.cpu_ms("forward"),
        "backward_tiles_cpu_ms": times.cpu_ms("backward"),
        "step_cpu_ms": None if step is None else step.cpu_ms("step"),
        "blend_cpu_speedup": None,
        "backward_tiles_cpu_speedup": None,
        # Processor time of all threads together: what peers are compared by.
        "forward_backward_cpu_s": 1e-3
        * _core.num_threads()
        * times.cpu_ms(*FORWARD_STAGES, *BACKWARD_STAGES),
        "mpairs_per_second_per_core": 1e-3
        * pairs
        * pixels
        / (times.cpu_ms("forward") * _core.num_threads()),
        "bytes_per_gaussian": statistics["buffer_bytes"] / count,
        "tile_pairs": statistics["num_pairs"],
        "contributing_tile_pairs": statistics["num_contributing_pairs"],
        "image_rms_error_all_pixels": errors.image_rms_all,
        "image_max_error": errors.image_max,
        "gradient_errors": errors.gradients,
        "error_sample": truth.sample,
        "scalar_image_rms_error": None if scalar is None else scalar.errors.image_rms,
        "repeats": times.repeats,
        "stages": times.per_stage_ms(),
        "step_stages": None if step is None else step.per_stage_ms(),
        "scalar_stages": None if scalar is None else scalar.times.per_stage_ms(),
        "load_average": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
        "origin": scene.origin,
    }
    for kind in ("forward", "backward", "blend", "backward_tiles"):
        _set_ratio(row, f"{kind}_speedup", f"scalar_{kind}_ms", f"{kind}_ms")
    for kind in ("blend", "backward_tiles"):
        _set_ratio(row, f"{kind}_cpu_speedup", f"scalar_{kind}_cpu_ms", f"{kind}_cpu_ms")
    if not row["valid"]:
        row.update(dict.fromkeys(_TIMED))
    return row


def _scalar_times(scalar: _Scalar | None) -> dict[str, float | None]:
    t: Any = None if scalar is None else scalar.times
    return {
        "scalar_forward_ms": t and t.wall_ms(*SCALAR_FORWARD_STAGES),
        "scalar_backward_ms": t and t.wall_ms(*BACKWARD_STAGES),
        "scalar_blend_ms": t and t.wall_ms("forward"),
        "scalar_backward_tiles_ms": t and t.wall_ms("backward"),
        "scalar_blend_cpu_ms": t and t.cpu_ms("forward"),
        "scalar_backward_tiles_cpu_ms": t and t.cpu_ms("backward"),
    }


def _set_ratio(row: dict[str, Any], key: str, above: str, below: str) -> None:
    if row[above] is not None and row[below]:
        row[key] = row[above] / row[below]


# --- the command ----------------------------------------------------------------------------------

HELP = (
    "forward, backward and training step on scenes made from a seed, beside their errors against "
    "the double reference and a plain scalar baseline; a wrong result (image rms above 1e-5, "
    "gradients above 1e-4, relative) prints no time"
)


def add_flags(parser: argparse.ArgumentParser) -> None:
    add_option_flags(parser, RenderBenchOptions)
    add_files(parser, "speed against error of the first scene, one knob turned at a time")


def run(arguments: argparse.Namespace) -> int:
    check_files(arguments)
    options = RenderBenchOptions(**given_options(RenderBenchOptions, arguments))
    if options.scalar_repeats and scalar_baseline is None:
        print("without the scalar baseline, which only ./run build in a clone makes")
        options = dataclasses.replace(options, scalar_repeats=0)
    with bar(num_measurements(options)) as advance:
        rows = render_bench(options, advance)
    print_and_write(rows, RENDER_COLUMNS, arguments)
    for row in rows:
        if not row["valid"]:
            print(
                f"no times for {row['name']} with {row['isa']}: image rms "
                f"{row['image_rms_error']:.1e}, gradients {row['gradient_relative_error']:.1e} are "
                "out of bounds"
            )
    if arguments.plot:
        scene = make_scene(options.scenes[0], ply=options.ply, data=options.data)
        others = len(_core.available_isas()) - 1
        with bar(1 + len(knob_settings()) + others + 2 * bool(options.scalar_repeats)) as advance:
            knobs = knob_bench(
                scene, repeats=options.repeats, tiles=options.tiles,
                with_scalar=bool(options.scalar_repeats), on_progress=advance,
            )  # fmt: skip
        print()
        print(table_text(knobs, KNOB_COLUMNS))
        plot_knobs(arguments.plot, knobs)
    return 0
