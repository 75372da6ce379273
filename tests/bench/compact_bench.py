"""`./run bench compact`: quality, size and speed of each method, and of training that small."""

from __future__ import annotations

import argparse
import dataclasses
import hashlib
import json
import statistics
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from gsut import _core
from gsut._core import InputError
from gsut.compact import (
    METHODS,
    SeenView,
    check_keep,
    check_method,
    compact,
    looks_at_views,
    scores_of,
    seen_views,
    settings_of,
)
from gsut.evaluate import evaluate, view_image
from gsut.render import Light
from gsut.run import (
    TrainOptions,
    add_option_flags,
    check_options,
    describe_options,
    given_options,
    option,
)
from gsut.training.tuning import finetune, finetune_options
from tests.bench.compact_starts import (
    TRAIN_CPU,
    StartRecipe,
    ThreadSeconds,
    check_start,
    trained_start,
)
from tests.bench.plots import plot_compact
from tests.bench.report_rows import (
    MEASURED,
    add_files,
    bar,
    check_files,
    print_and_write,
    row_writer,
    rows_to_keep,
)

DEFAULT_KEEPS = (0.05, 0.1, 0.2, 0.5)
# The rival's pace is measured on a run of so many steps with the same schedule.
_STARTS = "Starts"
_PILOT_STEPS = 120
# 3DGS PLY: position, normal, opacity, scales, rotation and the harmonics as float32.
_ROW_FLOATS = 14

COMPACT_COLUMNS = (
    ("scene", "scene", ""),
    ("start", "start", ""),
    ("method", "method", ""),
    ("keep", "keep", ".2f"),
    ("Gaussians", "num_gaussians", ",d"),
    ("MB", "megabytes", ".1f"),
    ("free dB", "free.psnr", ".2f"),
    ("SSIM", "free.ssim", ".4f"),
    ("ms", "free.render_ms", ".1f"),
    ("tuned dB", "tuned.psnr", ".2f"),
    ("SSIM", "tuned.ssim", ".4f"),
    ("ms", "tuned.render_ms", ".1f"),
    ("s", "total_seconds", ".0f"),
    ("rival dB", "rival.psnr", ".2f"),
    ("SSIM", "rival.ssim", ".4f"),
    ("ms", "rival.render_ms", ".1f"),
    ("s", "rival.total_seconds", ".0f"),
)


@describe_options
@dataclasses.dataclass(frozen=True)
class CompactBenchOptions:
    """What to compact and how: `runs` are folders of finished runs, over-complete as they are.

    Raises:
        InputError: an unknown method, a value of the wrong kind or out of range.
    """

    runs: Sequence[str]
    methods: tuple[str, ...] = option(METHODS, MEASURED, "of gsut compact")
    keep: tuple[float, ...] = option(DEFAULT_KEEPS, MEASURED, "fractions")
    finetune: int = option(500, MEASURED, "steps", low=1)
    rival: bool = option(
        True, MEASURED, "also train a model with each number of Gaussians from the start, for as "
        "long as training, compaction and fine-tuning took together",
    )  # fmt: skip
    start: tuple[str, ...] = option(
        (), _STARTS, "RUN are datasets, and these models of them are trained first: mcmc (up to "
        "--cap), adc (adaptive density control as published, without a cap), lean (up to --lean)",
    )  # fmt: skip
    folder: str | None = option(
        None, _STARTS, "holds, or gets, the starts' runs; those it holds are not trained again",
        none="no starts",
    )  # fmt: skip
    start_steps: int = option(1500, _STARTS, "of each start", low=1)
    cap: int = option(500_000, _STARTS, "most Gaussians of mcmc", low=1)
    lean: int = option(100_000, _STARTS, "most Gaussians of lean", low=1)
    scale: float = option(1.0, _STARTS, "of the datasets' images", low=0, high=1, low_open=True)

    @property
    def recipe(self) -> StartRecipe:
        """Of the starts."""
        return StartRecipe(self.start_steps, self.cap, self.lean, self.scale)

    def __post_init__(self) -> None:
        check_options(self)
        for start in self.start:
            check_start(start)
        if bool(self.start) != (self.folder is not None):
            raise InputError("--start and --folder go together: the models are written there")
        for method in self.methods:
            check_method(method, True)
        for keep in self.keep:
            check_keep(keep)


def num_parts(options: CompactBenchOptions) -> int:
    """How often `on_part` is called."""
    each = 1 + len(options.keep) * (len(options.methods) + options.rival)
    return len(options.runs) * max(1, len(options.start)) * (each + bool(options.start))


def compact_bench(
    options: CompactBenchOptions,
    on_part: Callable[[str], object] = lambda text: None,
    on_row: Callable[[list[dict[str, Any]]], object] = lambda rows: None,
    done: Sequence[dict[str, Any]] = (),
) -> list[dict[str, Any]]:
    """Compacts each run with each method to each fraction.

    Seconds and milliseconds are processor time over threads, so that other work on the machine
    counts little; only of runs that the benchmark did not train itself, training's is wall time.

    Args:
        options: what to do.
        on_part: called before each part of the work with its name.
        on_row: called with all rows so far after each of them.
        done: rows of an earlier call. Those of the same run, method, fraction and settings are not
            made again; those of the same with other settings are dropped; all others stay.

    Returns:
        One row a run ("method": "whole") and one a method and fraction: dict run, scene, start,
        method, keep, settings (a digest of all that decides the result but the code),
        num_gaussians, megabytes (of a PLY file), compact_seconds, finetune_seconds,
        total_seconds; `free` (before fine-tuning), `tuned` and `rival`, each a dict psnr, ssim,
        render_ms, of the rival also num_gaussians, steps and total_seconds; and `source` with
        num_gaussians, psnr, ssim, render_ms of the whole model. Ordered by run, fraction, method.

    Raises:
        InputError: a run that is not finished, or whose dataset holds no view out.
    """
    rows = list(done)
    for name in options.runs:
        if not options.start:
            _bench_run(name, "run", options, rows, on_part, on_row)
            continue
        assert options.folder is not None
        for start in options.start:
            on_part(f"{Path(name).name} {start} training")
            folder = trained_start(name, start, options.recipe, options.folder)
            _bench_run(str(folder), start, options, rows, on_part, on_row)
    return _ordered(rows)


def _ordered(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows by run as they first come, the whole model first, then by fraction and method."""
    runs = list(dict.fromkeys(row["run"] for row in rows))
    methods = ("whole", *METHODS)

    def place(row: dict[str, Any]) -> tuple[int, float, int]:
        method = row["method"]
        return runs.index(row["run"]), row["keep"] * (method != "whole"), methods.index(method)

    return sorted(rows, key=place)


def _bench_run(
    folder: str,
    start: str,
    options: CompactBenchOptions,
    rows: list[dict[str, Any]],
    on_part: Callable[[str], object],
    on_row: Callable[[list[dict[str, Any]]], object],
) -> None:
    scene, gaussians, train_options, train_seconds, light = _read(folder)
    views = seen_views(scene, scene.train_indices)
    name = f"{scene.path.name} {start}"
    key = {"run": str(Path(folder).resolve()), "scene": scene.path.name, "start": start}

    on_part(f"{name} whole")
    key["settings"] = _digest(train_options)
    whole = _found(rows, key, "whole", 1.0)
    if whole is None:
        figures = _figures(gaussians, scene, train_options, light)
        whole = {
            **key, "method": "whole", "keep": 1.0,
            "num_gaussians": len(gaussians), "megabytes": _megabytes(gaussians),
            "free": figures, "total_seconds": train_seconds,
            "source": {"num_gaussians": len(gaussians), **figures},
        }  # fmt: skip
        rows.append(whole)
        on_row(rows)
    scores: dict[str, tuple[Any, float]] = {}  # found once a method, and their seconds

    def scored(method: str, seen: Sequence[SeenView]) -> tuple[Any, float]:
        if method not in scores:
            clock = ThreadSeconds()
            scores[method] = scores_of(gaussians, method, seen), clock.seconds()
        return scores[method]

    for keep in options.keep:
        made = []
        count = max(1, round(keep * len(gaussians)))
        for method in options.methods:
            on_part(f"{name} {method} {keep:g}")
            tuning = finetune_options(train_options, options.finetune, count)
            key["settings"] = _digest(tuning, settings_of(method))
            row = _found(rows, key, method, keep)
            if row is None:
                seen: Sequence[SeenView] = views if looks_at_views(method) else ()
                row = key | _one(
                    gaussians, scene, train_options, seen, method, keep, options.finetune,
                    scored(method, seen), light,
                )  # fmt: skip
                row["total_seconds"] = (
                    train_seconds + row["compact_seconds"] + row["finetune_seconds"]
                )
                row["source"] = whole["source"]
                rows.append(row)
                on_row(rows)
            made.append(row)
        if options.rival:
            on_part(f"{name} rival {keep:g}")
            settings = _digest(_rival_options(train_options, count, _PILOT_STEPS), options.finetune)
            had = [row["rival"] for row in made if "rival" in row]
            rival = next((it for it in had if it.get("settings") == settings), None)
            if rival is None:
                budget = max(row["total_seconds"] for row in made)
                pace = statistics.median(row["finetune_seconds"] for row in made) / options.finetune
                rival = {
                    "settings": settings, **_rival(scene, train_options, count, budget, pace)
                }  # fmt: skip
            for row in made:
                row["rival"] = rival
            on_row(rows)


def _digest(options: TrainOptions, *more: Any) -> str:
    """Short name of settings; threads do not change a result."""
    values = [dataclasses.asdict(dataclasses.replace(options, threads=0)), *more]
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()[:12]


def _found(
    rows: list[dict[str, Any]], key: dict[str, Any], method: str, keep: float
) -> dict[str, Any] | None:
    """The row of a run, method and fraction; one with other settings is taken out of `rows`."""
    wanted = (key["run"], method, keep)
    row = next((r for r in rows if (r["run"], r["method"], r["keep"]) == wanted), None)
    if row is None or row.get("settings") == key["settings"]:
        return row
    rows.remove(row)
    return None


def _read(folder: str) -> tuple[Any, Any, TrainOptions, float, Light | None]:
    """Scene, Gaussians, options, seconds of training and light of the photographs of a finished run
    with held-out views."""
    from gsut.run import METRICS, RunFolder
    from gsut.training import read_light, read_trained

    run = RunFolder.open(folder)
    metrics = run.read_json(METRICS)
    if metrics is None:
        raise InputError(f"{folder} is not finished; resume it")
    train_options, scene, gaussians = read_trained(run, None)
    if not scene.test_indices:
        raise InputError(f"{scene.path} has no held-out views to measure PSNR on")
    seconds = metrics.get(TRAIN_CPU, metrics["train_seconds"])
    return scene, gaussians, train_options, seconds, read_light(run, scene)


def _one(
    gaussians: Any,
    scene: Any,
    options: TrainOptions,
    views: Sequence[SeenView],
    method: str,
    keep: float,
    steps: int,
    scored: tuple[Any, float],
    light: Light | None,
) -> dict[str, Any]:
    clock = ThreadSeconds()
    small = compact(gaussians, keep, method=method, views=views, scores=scored[0]).gaussians
    compact_seconds = scored[1] + clock.seconds()
    free = _figures(small, scene, options, light)
    clock = ThreadSeconds()
    tuned, _ = finetune(scene, small, finetune_options(options, steps, len(small)), light=light)
    finetune_seconds = clock.seconds()
    return {
        "method": method, "keep": keep,
        "num_gaussians": len(small), "megabytes": _megabytes(small),
        "compact_seconds": compact_seconds, "finetune_steps": steps,
        "finetune_seconds": finetune_seconds,
        "free": free, "tuned": _figures(tuned, scene, options, light),
    }  # fmt: skip


def _rival(
    scene: Any, options: TrainOptions, count: int, budget: float, full_pace: float
) -> dict[str, Any]:
    """A model of `count` Gaussians trained from the start for `budget` seconds."""
    guess = max(_PILOT_STEPS, round(budget / full_pace))
    schedule = _rival_options(options, count, guess)
    pilot = dataclasses.replace(
        schedule, steps=_PILOT_STEPS, densify_every=max(1, _PILOT_STEPS // 20)
    )
    # At least what the steps at full resolution take at fine-tuning's pace: young Gaussians overlap
    # less, and with the pilot alone a rival on fox took 47 s for 36.
    full_size = 1.0 - schedule.coarse_to_fine[1]
    pace = max(_train(scene, pilot)[1] / _PILOT_STEPS, full_size * full_pace)
    chosen = _rival_options(options, count, max(_PILOT_STEPS, round(budget / pace)))
    gaussians, seconds, light = _train(scene, chosen)
    return {
        "num_gaussians": len(gaussians), "steps": chosen.steps, "total_seconds": seconds,
        **_figures(gaussians, scene, options, light),
    }  # fmt: skip


def _rival_options(options: TrainOptions, count: int, steps: int) -> TrainOptions:
    """The recipe for this many steps; of the run only what concerns data and appearance."""
    return TrainOptions(
        steps=steps,
        max_gaussians=count,
        sh_degree=options.sh_degree,
        scale=options.scale,
        seed=options.seed,
        threads=options.threads,
        background=options.background,
        shutter=options.shutter,
        readout_time=options.readout_time,
        readout_direction=options.readout_direction,
        test_every=options.test_every,
        test_names=options.test_names,
    ).resolved()


def _train(scene: Any, options: TrainOptions) -> tuple[Any, float, Light | None]:
    from gsut.training import TrainingLoop

    loop = TrainingLoop(scene, options)
    clock = ThreadSeconds()
    while loop.step < options.steps:
        loop.advance()
    return loop.make_result().copy(), clock.seconds(), loop.photographs.find_light()


def _figures(
    gaussians: Any, scene: Any, options: TrainOptions, light: Light | None
) -> dict[str, float]:
    figures = evaluate(
        gaussians, scene, scene.test_indices, background=options.background, light=light
    )
    milliseconds = _render_ms(gaussians, scene, options)
    return {"psnr": figures["psnr"], "ssim": figures["ssim"], "render_ms": milliseconds}


def _render_ms(gaussians: Any, scene: Any, options: TrainOptions) -> float:
    """Median over the held-out views of one image's processor time over threads."""
    renderer, times = _core.Renderer(), []
    for index in (scene.test_indices[0], *scene.test_indices):  # the first once more: buffers grow
        clock = ThreadSeconds()
        view_image(scene, gaussians, index, options.background, renderer)
        times.append(1e3 * clock.seconds())
    return statistics.median(times[1:])


def _megabytes(gaussians: Any) -> float:
    return 4 * (_ROW_FLOATS + 3 * gaussians.sh.shape[1]) * len(gaussians) / 1e6


# --- the command ----------------------------------------------------------------------------------

HELP = (
    "quality, size and speed of each method of compaction, with and without fine-tuning, beside a "
    "model trained that small from the start in the same total time"
)


def add_flags(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "runs", metavar="RUN", nargs="+", help="finished runs; with --start, datasets"
    )
    add_option_flags(parser, CompactBenchOptions)
    add_files(parser, "PSNR against Gaussians and render time", resume=True)


def run(arguments: argparse.Namespace) -> int:
    check_files(arguments)
    options = CompactBenchOptions(arguments.runs, **given_options(CompactBenchOptions, arguments))
    done = rows_to_keep(arguments)
    with bar(num_parts(options)) as advance:
        rows = compact_bench(options, advance, row_writer(arguments), done)
    print_and_write(rows, COMPACT_COLUMNS, arguments)
    if arguments.plot:
        plot_compact(arguments.plot, rows)
    return 0
