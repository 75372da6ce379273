"""What each benchmark of `gsut bench` does, step by step (see arguments.py for the flags)."""

from __future__ import annotations

import argparse
import contextlib
import itertools
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from gsut import _core
from gsut._core import InputError
from gsut.bench.plots import check_plot_path, plot_curves, plot_knobs, plot_scale
from gsut.bench.report_rows import (
    RENDER_COLUMNS,
    read_rows,
    table_text,
    write_csv,
    write_json,
)
from gsut.run import Progress


def render(arguments: argparse.Namespace) -> int:
    """`gsut bench render`."""
    _check_files(arguments)
    if arguments.scale:
        return _scale(arguments)
    for flag in ("counts", "megapixels"):
        if getattr(arguments, flag):
            raise InputError(f"--{flag} goes with --scale")
    from gsut.bench.knobs import KNOB_COLUMNS, knob_bench, knob_settings
    from gsut.bench.measure import scalar_baseline
    from gsut.bench.render_bench import (
        DEFAULT_SCENES,
        RenderBenchOptions,
        num_measurements,
        render_bench,
    )
    from gsut.bench.scenes import make_scene

    scalar_repeats = arguments.scalar_repeats
    if scalar_repeats and scalar_baseline is None:
        print("without the scalar baseline, which only ./run build in a clone makes")
        scalar_repeats = 0
    options = RenderBenchOptions(
        scenes=_words(arguments.scenes) or DEFAULT_SCENES,
        isas=_words(arguments.isa),
        threads=_numbers(arguments.threads, int, "--threads"),
        repeats=arguments.repeats,
        scalar_repeats=scalar_repeats,
        steps=10 if arguments.steps is None else arguments.steps,
        tiles=arguments.tiles,
        ply=arguments.ply,
        data=arguments.data,
    )
    with _bar(num_measurements(options)) as advance:
        rows = render_bench(options, advance)
    _print_and_write(rows, RENDER_COLUMNS, arguments)
    wrong = [row for row in rows if not row["valid"]]
    for row in wrong:
        print(
            f"no times for {row['name']} with {row['isa']}: image rms {row['image_rms_error']:.1e},"
            f" gradients {row['gradient_relative_error']:.1e} are out of bounds"
        )
    if arguments.plot:
        scene = make_scene(options.scenes[0], ply=options.ply, data=options.data)
        others = len(_core.available_isas()) - 1
        with _bar(1 + len(knob_settings()) + others + 2 * bool(options.scalar_repeats)) as advance:
            knobs = knob_bench(
                scene, repeats=options.repeats, tiles=options.tiles,
                with_scalar=bool(options.scalar_repeats), on_progress=advance,
            )  # fmt: skip
        print()
        print(table_text(knobs, KNOB_COLUMNS))
        plot_knobs(arguments.plot, knobs)
    return 0


def _scale(arguments: argparse.Namespace) -> int:
    """`gsut bench render --scale`."""
    from gsut.bench.scale_bench import (
        DEFAULT_COUNTS,
        DEFAULT_MEGAPIXELS,
        SCALE_COLUMNS,
        ScaleOptions,
        add_linear_fit,
        scale_bench,
    )
    from gsut.bench.scenes import parsed_count

    (threads, *more) = _numbers(arguments.threads, int, "--threads")
    if more:
        raise InputError("--scale takes one number of --threads")
    options = ScaleOptions(
        counts=[parsed_count(word) for word in _words(arguments.counts)] or DEFAULT_COUNTS,
        megapixels=_numbers(arguments.megapixels, float, "--megapixels") or DEFAULT_MEGAPIXELS,
        threads=threads,
        steps=5 if arguments.steps is None else arguments.steps,
    )
    before = _core.active_isa()
    if arguments.isa:
        _core.set_isa(arguments.isa)
    try:
        with _bar(len(options.counts) * len(options.megapixels)) as advance:
            rows = scale_bench(options, advance)
    finally:
        _core.set_isa(before)
    _print_and_write(rows, SCALE_COLUMNS, arguments)
    per_gaussian, per_pixel = add_linear_fit(rows)
    print(
        f"step = {1e6 * per_gaussian:.0f} ns a Gaussian + {1e6 * per_pixel:.0f} ns a pixel "
        "(processor time / threads)"
    )
    if arguments.plot:
        plot_scale(arguments.plot, rows)
    return 0


def train(arguments: argparse.Namespace) -> int:
    """`gsut bench train DATA`."""
    from gsut.bench.train_bench import (
        CURVE_COLUMNS,
        TRAIN_COLUMNS,
        TrainBenchOptions,
        stage_rows,
        train_bench,
    )
    from gsut.run import PRESETS

    _check_files(arguments)
    options = TrainBenchOptions(
        data=arguments.data,
        presets=_words(arguments.presets) or tuple(PRESETS),
        measurements=arguments.measurements,
        scale=arguments.scale,
        threads=arguments.threads,
        overrides={} if arguments.steps is None else {"steps": arguments.steps},
    )
    with Progress() as bars:

        def on_step(state: dict[str, Any]) -> None:
            numbers = state["loss"], state["num_gaussians"], state["psnr"]
            bars.show_step(state["step"], state["steps"], *numbers)

        rows = train_bench(options, on_step)
    print(table_text([point for row in rows for point in row["curve"]], CURVE_COLUMNS))
    print()
    _print_and_write(rows, TRAIN_COLUMNS, arguments)
    print("\nmilliseconds a step by stage (processor time / threads)")
    columns = (("stage", "stage", ""), *((row["preset"], row["preset"], ".2f") for row in rows))
    print(table_text(stage_rows(rows), columns))
    for row in rows:
        passed = ", ".join(f"{level} dB in {s:.1f} s" for level, s in row["seconds_to_db"].items())
        print(f"{row['preset']}: {passed or 'no whole dB passed between two measurements'}")
    if arguments.plot:
        plot_curves(arguments.plot, {row["preset"]: row["curve"] for row in rows})
    return 0


def poses(arguments: argparse.Namespace) -> int:
    """`gsut bench poses DATA...`."""
    from gsut.bench.poses_bench import POSES_COLUMNS, PosesBenchOptions, poses_bench

    _check_files(arguments)
    if arguments.rig:
        return _poses_on_rig(arguments)
    options = PosesBenchOptions(
        data=arguments.data, lenses=_words(arguments.lenses), threads=arguments.threads,
        shutters=_words(arguments.shutters), programs=_words(arguments.programs),
        pycolmap=arguments.pycolmap, train_steps=arguments.train,
        train_scale=arguments.train_scale,
    )  # fmt: skip
    with _bar(options.num_rows) as advance:
        rows = poses_bench(options, advance, _row_writer(arguments), _rows_to_keep(arguments))
    _print_and_write(rows, POSES_COLUMNS, arguments)
    for row in rows:
        if "failure" in row:
            print(f"{row['data']}, {row['program']}, lens {row['lens']}: {row['failure']}")
    return 0


def _poses_on_rig(arguments: argparse.Namespace) -> int:
    """`gsut bench poses DATA --rig RIG`."""
    from gsut.bench.rig_poses import RIG_COLUMNS, WAYS, RigBenchOptions, rig_bench

    if len(arguments.data) != 1:
        raise InputError(f"--rig goes with one dataset, found {len(arguments.data)}")
    options = RigBenchOptions(arguments.data[0], arguments.rig, arguments.threads)
    with _bar(len(WAYS)) as advance:
        rows = rig_bench(options, advance)
    _print_and_write(rows, RIG_COLUMNS, arguments)
    for row in rows:
        if "failure" in row:
            print(f"{row['data']}, {row['way']}: {row['failure']}")
    return 0


def refine(arguments: argparse.Namespace) -> int:
    """`gsut bench refine DATA`."""
    from gsut.bench.plots import plot_basin
    from gsut.bench.refine_basin import BASIN_COLUMNS, BASIN_DEGREES
    from gsut.bench.refine_bench import (
        REFINE_COLUMNS,
        RefineBenchOptions,
        num_parts,
        refine_bench,
    )
    from gsut.bench.refine_disturb import DISTURBANCES

    _check_files(arguments)
    basin = _numbers(arguments.basin, float, "--basin") or list(BASIN_DEGREES)
    options = RefineBenchOptions(
        data=arguments.data,
        cases=_words(arguments.cases) or [each.name for each in DISTURBANCES],
        steps=arguments.steps,
        gaussians=arguments.gaussians,
        scale=arguments.scale,
        threads=arguments.threads,
        seed=arguments.seed,
        jitter=arguments.jitter,
        tracks=not arguments.no_tracks,
        basin=[] if arguments.no_basin else basin,
    )
    with _bar(num_parts(options)) as advance:
        rows, basin_rows = refine_bench(
            options, advance, _row_writer(arguments), _rows_to_keep(arguments)
        )
    print(table_text(rows, REFINE_COLUMNS))
    print(f"points moved by {options.jitter:g} (one sigma): a data set's own may be exact")
    if basin_rows:
        print("\nshare of poses that come back to 0.1 degrees and 0.01 units")
        print(table_text(basin_rows, BASIN_COLUMNS))
        if arguments.plot:
            plot_basin(arguments.plot, basin_rows)
    if arguments.csv:
        write_csv(arguments.csv, [*rows, *basin_rows])
    return 0


def compact(arguments: argparse.Namespace) -> int:
    """`gsut bench compact RUN...`."""
    from gsut.bench.compact_bench import (
        COMPACT_COLUMNS,
        DEFAULT_KEEPS,
        CompactBenchOptions,
        compact_bench,
        num_parts,
    )
    from gsut.bench.compact_starts import StartRecipe
    from gsut.bench.plots import plot_compact
    from gsut.compact import METHODS

    _check_files(arguments)
    options = CompactBenchOptions(
        runs=arguments.runs,
        methods=_words(arguments.methods) or METHODS,
        keeps=_numbers(arguments.keep, float, "--keep") or DEFAULT_KEEPS,
        finetune=arguments.finetune,
        rival=not arguments.no_rival,
        starts=_words(arguments.start),
        folder=arguments.folder,
        recipe=StartRecipe(arguments.start_steps, arguments.cap, arguments.lean, arguments.scale),
    )
    done = _rows_to_keep(arguments)
    with _bar(num_parts(options)) as advance:
        rows = compact_bench(options, advance, _row_writer(arguments), done)
    _print_and_write(rows, COMPACT_COLUMNS, arguments)
    if arguments.plot:
        plot_compact(arguments.plot, rows)
    return 0


def projection(arguments: argparse.Namespace) -> int:
    """`gsut bench projection`."""
    from gsut.bench.projection_bench import (
        PROJECTION_COLUMNS,
        ProjectionBenchOptions,
        bench_lenses,
        million_row,
        projection_bench,
    )
    from gsut.bench.projection_plots import plot_projection

    _check_files(arguments)
    if arguments.plots and not Path(arguments.plots).is_dir():
        raise InputError(f"--plots {arguments.plots}: there is no such folder; make it first")
    if arguments.samples < 1:
        raise InputError(f"--samples must be at least 1, found {arguments.samples}")
    options = ProjectionBenchOptions(
        lenses=_words(arguments.lenses),
        samples=arguments.samples,
    )
    with _bar(len(bench_lenses(options.lenses))) as advance:
        rows = projection_bench(options, advance)
    _print_and_write(rows, PROJECTION_COLUMNS, arguments)
    if not arguments.no_million:
        from gsut.bench.lens_cost import lens_cost_row

        row = million_row()
        cost = lens_cost_row()
        print(
            f"processor time through a splined lens over a pinhole of the same image: forward and "
            f"backward {cost['ratio_forward_backward']:.3f}, forward {cost['ratio_forward']:.3f}, "
            f"projection {cost['ratio_project']:.2f}"
        )
        print(
            f"unscented projection of {row['num_gaussians']} Gaussians: {row['cpu_seconds']:.4f} "
            f"CPU-s; gsplat's PyTorch reference {row['peer_cpu_seconds']:g} CPU-s, "
            f"{row['peer_over_gsut']:.0f} times as much"
        )
        if arguments.json:
            write_json(arguments.json, [*rows, row, cost])
    if arguments.plots:
        plot_projection(arguments.plots, rows)
    return 0


def _print_and_write(
    rows: list[dict[str, Any]],
    columns: Sequence[tuple[str, str, str]],
    arguments: argparse.Namespace,
) -> None:
    print(table_text(rows, columns))
    if arguments.json:
        write_json(arguments.json, rows)
    if arguments.csv:
        write_csv(arguments.csv, rows)


def _rows_to_keep(arguments: argparse.Namespace) -> list[dict[str, Any]]:
    """With --resume, the rows that an earlier call wrote."""
    if not arguments.resume:
        return []
    if not arguments.json:
        raise InputError("--resume goes on with the rows of --json FILE; name that file")
    return read_rows(arguments.json)


def _row_writer(arguments: argparse.Namespace) -> Callable[[list[dict[str, Any]]], None]:
    """Writes --json after every row: it takes long, and a killed call then loses one."""

    def write(rows: list[dict[str, Any]]) -> None:
        if arguments.json:
            write_json(arguments.json, rows)

    return write


def _check_files(arguments: argparse.Namespace) -> None:
    """Refuses what cannot be written before anything is measured."""
    if arguments.plot:
        check_plot_path(arguments.plot)
    for flag in ("json", "csv", "plot"):
        path = getattr(arguments, flag)
        if path and not Path(path).absolute().parent.is_dir():
            raise InputError(f"--{flag} {path}: there is no such folder; make it first")


def _words(text: str | None) -> list[str]:
    return [word.strip() for word in (text or "").split(",") if word.strip()]


def _numbers(text: str | None, kind: Callable[[str], Any], flag: str) -> list[Any]:
    try:
        return [kind(word) for word in _words(text)]
    except ValueError:
        raise InputError(f'{flag} takes numbers with commas between, found "{text}"') from None


@contextlib.contextmanager
def _bar(total: int) -> Iterator[Callable[[str], None]]:
    """Progress on standard error; gives the function that is told what begins."""
    begun = itertools.count()
    with Progress(sys.stderr.isatty()) as bars:
        yield lambda text: bars.show("measured", next(begun), total, text)
