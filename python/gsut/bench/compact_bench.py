"""`gsut bench compact`: quality, size and speed of each method, and of training that small."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from gsut import _core
from gsut._core import InputError
from gsut.compact import METHODS, check_keep, check_method, compact, looks_at_views
from gsut.compact_scores import SeenView, seen_views
from gsut.evaluate import evaluate
from gsut.finetune import finetune, finetune_options
from gsut.options import TrainOptions

DEFAULT_KEEPS = (0.05, 0.1, 0.2, 0.5)
# The rival's pace is measured on a run of so many steps with the same schedule.
_PILOT_STEPS = 120
# 3DGS PLY: position, normal, opacity, scales, rotation and the harmonics as float32.
_ROW_FLOATS = 14

COMPACT_COLUMNS = (
    ("scene", "scene", ""),
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


@dataclasses.dataclass(frozen=True)
class CompactBenchOptions:
    """What to compact and how.

    Args:
        runs: folders of finished runs, as over-complete as their training left them.
        methods: of `gsut.compact`.
        keeps: fractions.
        finetune: steps.
        rival: also train a model with each number of Gaussians from the start, for as long as
            training, compaction and fine-tuning took together.

    Raises:
        InputError: an unknown method, a fraction out of range, or no fine-tuning.
    """

    runs: Sequence[str]
    methods: Sequence[str] = METHODS
    keeps: Sequence[float] = DEFAULT_KEEPS
    finetune: int = 500
    rival: bool = True

    def __post_init__(self) -> None:
        for method in self.methods:
            check_method(method, True)
        for keep in self.keeps:
            check_keep(keep)
        if self.finetune < 1:
            raise InputError(f"--finetune must be at least 1 step, found {self.finetune}")


def num_parts(options: CompactBenchOptions) -> int:
    """How often `on_part` is called."""
    each = 1 + len(options.keeps) * (len(options.methods) + options.rival)
    return len(options.runs) * each


def compact_bench(
    options: CompactBenchOptions,
    on_part: Callable[[str], object] = lambda text: None,
    on_row: Callable[[list[dict[str, Any]]], object] = lambda rows: None,
) -> list[dict[str, Any]]:
    """Compacts each run with each method to each fraction.

    Seconds are processor time over threads, so that other work on the machine counts little: of
    the run's training (wall time, from its metrics.json), the compaction and the fine-tuning.

    Args:
        options: what to do.
        on_part: called before each part of the work with its name.
        on_row: called with all rows so far after each of them.

    Returns:
        One row a run ("method": "whole") and one a method and fraction: dict scene, method, keep,
        num_gaussians, megabytes (of a PLY file), compact_seconds, finetune_seconds,
        total_seconds; `free` (before fine-tuning), `tuned` and `rival`, each a dict psnr, ssim,
        render_ms, of the rival also num_gaussians, steps and total_seconds; and `source` with
        num_gaussians, psnr, render_ms of the whole model.

    Raises:
        InputError: a run that is not finished, or whose dataset holds no view out.
    """
    rows: list[dict[str, Any]] = []
    for folder in options.runs:
        _bench_run(folder, options, rows, on_part, on_row)
    return rows


def _bench_run(
    folder: str,
    options: CompactBenchOptions,
    rows: list[dict[str, Any]],
    on_part: Callable[[str], object],
    on_row: Callable[[list[dict[str, Any]]], object],
) -> None:
    import gsut
    from gsut.run_folder import ENVIRONMENT, METRICS, SCENE, RunFolder

    run = RunFolder.open(folder)
    metrics, train_options = run.read_json(METRICS), run.read_options()
    if metrics is None:
        raise InputError(f"{folder} is not finished; resume it")
    scene = gsut.load_dataset(
        (run.read_json(ENVIRONMENT) or {})["dataset"],
        test_every=train_options.test_every,
        test_names=train_options.test_names,
        scale=train_options.scale,
    )
    if not scene.test_indices:
        raise InputError(f"{scene.path} has no held-out views to measure PSNR on")
    gaussians = gsut.load_ply(run.path / SCENE)
    views = seen_views(scene, scene.train_indices)
    on_part(f"{scene.path.name} whole")
    whole = _figures(gaussians, scene, train_options)
    source = {"num_gaussians": len(gaussians), **whole}
    row = {
        "scene": Path(scene.path).name, "method": "whole", "keep": 1.0,
        "num_gaussians": len(gaussians), "megabytes": _megabytes(gaussians),
        "free": whole, "total_seconds": metrics["train_seconds"], "source": source,
    }  # fmt: skip
    rows.append(row)
    on_row(rows)
    for keep in options.keeps:
        made = []
        for method in options.methods:
            on_part(f"{scene.path.name} {method} {keep:g}")
            seen: Sequence[SeenView] = views if looks_at_views(method) else ()
            row = _one(gaussians, scene, train_options, seen, method, keep, options.finetune)
            row["total_seconds"] = (
                metrics["train_seconds"] + row["compact_seconds"] + row["finetune_seconds"]
            )
            made.append(row | {"source": source})
            rows.append(made[-1])
            on_row(rows)
        if options.rival:
            on_part(f"{scene.path.name} rival {keep:g}")
            budget = max(row["total_seconds"] for row in made)
            pace = min(row["finetune_seconds"] for row in made) / options.finetune
            count = max(1, round(keep * len(gaussians)))
            found = _rival(scene, train_options, count, budget, pace)
            for row in made:
                row["rival"] = found
            on_row(rows)


def _one(
    gaussians: Any,
    scene: Any,
    options: TrainOptions,
    views: Sequence[SeenView],
    method: str,
    keep: float,
    steps: int,
) -> dict[str, Any]:
    clock = _ThreadSeconds()
    small = compact(gaussians, keep, method=method, views=views).gaussians
    compact_seconds = clock.seconds()
    free = _figures(small, scene, options)
    clock = _ThreadSeconds()
    tuned, _ = finetune(scene, small, finetune_options(options, steps, len(small)))
    finetune_seconds = clock.seconds()
    return {
        "scene": Path(scene.path).name, "method": method, "keep": keep,
        "num_gaussians": len(small), "megabytes": _megabytes(small),
        "compact_seconds": compact_seconds, "finetune_steps": steps,
        "finetune_seconds": finetune_seconds,
        "free": free, "tuned": _figures(tuned, scene, options),
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
    pace = _train(scene, pilot)[1] / _PILOT_STEPS
    chosen = _rival_options(options, count, max(_PILOT_STEPS, round(budget / pace)))
    gaussians, seconds = _train(scene, chosen)
    return {
        "num_gaussians": len(gaussians), "steps": chosen.steps, "total_seconds": seconds,
        **_figures(gaussians, scene, options),
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
        test_every=options.test_every,
        test_names=options.test_names,
    ).resolved()


def _train(scene: Any, options: TrainOptions) -> tuple[Any, float]:
    from gsut.train import TrainingLoop

    loop = TrainingLoop(scene, options)
    clock = _ThreadSeconds()
    while loop.step < options.steps:
        loop.advance()
    return loop.gaussians.copy(), clock.seconds()


def _figures(gaussians: Any, scene: Any, options: TrainOptions) -> dict[str, float]:
    figures = evaluate(gaussians, scene, scene.test_indices, background=options.background)
    return {key: figures[key] for key in ("psnr", "ssim", "render_ms")}


def _megabytes(gaussians: Any) -> float:
    return 4 * (_ROW_FLOATS + 3 * gaussians.sh.shape[1]) * len(gaussians) / 1e6


class _ThreadSeconds:
    """Processor seconds since it was made, over the number of threads."""

    def __init__(self) -> None:
        self._begun = time.process_time()

    def seconds(self) -> float:
        return (time.process_time() - self._begun) / _core.num_threads()
