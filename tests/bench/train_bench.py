"""`./run bench train`: what whole commands of `gsut train` reach and take."""

from __future__ import annotations

import shlex
from collections.abc import Iterator

from tests.bench.commands import train
from tests.bench.harness import HALL, Benchmark, Column, Option, Row, Settings

_QUARTER = "--scale 0.25"
# Dataset -> the flags of its runs.
RUNS: dict[str, tuple[str, ...]] = {
    HALL: ("--preset fast", "--preset balanced"),
    "sponza_fisheye": ("--preset fast", "--preset balanced"),
    "fox": (
        f"{_QUARTER} --steps 350 --max-gaussians 40000",
        f"{_QUARTER} --steps 700 --max-gaussians 60000",
        "--max-side 0 --steps 500 --max-gaussians 60000",
    ),
    "helmet_distorted_rs": ("--steps 1000",),
}


def list_cases(settings: Settings) -> Iterator[Row]:
    """Lists datasets with the flags of their runs, or with those of --flags."""
    for name in settings.sets or RUNS:
        for number, flags in enumerate(settings.flags or RUNS.get(name, RUNS[HALL])):
            yield {"data": name, "flags": flags, "_number": number}


def measure(case: Row, settings: Settings) -> Row:
    """Trains anew."""
    data = settings.path(case["data"])
    count = sum(path.is_dir() for path in settings.folder.glob("run-*"))
    metrics = train(data, settings.folder / f"run-{count}", shlex.split(case["flags"]))
    return {key: metrics.get(key) for key in _KEYS}


_KEYS = (
    "psnr",
    "ssim",
    "num_gaussians",
    "steps",
    "train_seconds",
    "seconds",
    "cpu_seconds",
    "peak_mb",
)
BENCHMARK = Benchmark(
    help="held-out PSNR beside the seconds of whole commands: imports, decoding and report count",
    columns=(
        Column("data"),
        Column("flags"),
        Column("psnr", "held-out PSNR", "dB", ".2f"),
        Column("ssim", "SSIM", form=".4f"),
        Column("num_gaussians", "Gaussians", form=",d"),
        Column("steps", form="d"),
        Column("train_seconds", "training", "s", ".1f"),
        Column("seconds", "whole command", "s", ".1f"),
        Column("cpu_seconds", "whole command", "CPU-s", ".1f"),
        Column("peak_mb", "peak memory", "MB", ",.0f"),
    ),
    cases=list_cases,
    measure=measure,
    options=(Option("flags", (), "flags of gsut train, runs with commas between"),),
)
