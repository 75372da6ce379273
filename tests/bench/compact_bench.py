"""`./run bench compact`: quality, size and speed of compacted models and their rivals."""

from __future__ import annotations

import statistics
import time
from collections.abc import Iterator
from pathlib import Path

import gsut
from gsut import _core
from gsut.compact import check_keep, check_method
from gsut.compact.method import METHODS
from gsut.evaluate import evaluate
from gsut.evaluate.held_out import render_view_image
from tests.bench.commands import run_gsut, train
from tests.bench.harness import HALL, Benchmark, Column, Option, Row, Settings

WHOLE = "whole model"
RIVAL = "trained that small"


def list_cases(settings: Settings) -> Iterator[Row]:
    """Lists datasets with the whole model, and each share by each method and trained anew."""
    for method in settings.methods:
        check_method(method, True)
    for keep in settings.keep:
        check_keep(keep)
    for data in settings.sets or (HALL, "sponza_fisheye", "fox"):
        yield {"data": data, "method": WHOLE, "keep": ""}
        for keep in settings.keep:
            for method in (*settings.methods, RIVAL):
                yield {"data": data, "method": method, "keep": f"{keep:g}"}


def measure(case: Row, settings: Settings) -> Row:
    """Compacts the whole model, or trains anew for the steps of both, and compares views."""
    name, method = case["data"], case["method"]
    label = name.replace("/", "_")
    whole = settings.folder / f"{label}-whole"
    words = ["--steps", str(settings.steps), "--max-gaussians", str(settings.cap)]
    words += ["--scale", str(settings.scale)]
    took = train(settings.path(name), whole, words)
    out = settings.folder / f"{label}-{method.replace(' ', '-')}-{case['keep']}"
    if method == WHOLE:
        out = whole
    elif method == RIVAL:
        count = round(float(case["keep"]) * len(gsut.load_run(whole).gaussians))
        words[1], words[3] = str(settings.steps + settings.finetune), str(count)
        took = train(settings.path(name), out, words)
    else:
        words = ["--keep", case["keep"], "--method", method, "--finetune", str(settings.finetune)]
        seconds = run_gsut(["compact", str(whole), *words], out)
        took = {key: took[key] + seconds[key] for key in ("seconds", "cpu_seconds")}
    return measure_model(out) | {key: took[key] for key in ("seconds", "cpu_seconds")}


def measure_model(run: Path) -> Row:
    """Measures a run's quality on held-out views, its size, and the time of a view."""
    trained = gsut.load_run(run)
    scene, background = trained.scene, trained.options.background
    figures = evaluate(
        trained.gaussians, scene, scene.test_indices, background=background, light=trained.light
    )
    renderer, times = _core.Renderer(), []
    for index in (scene.test_indices[0], *scene.test_indices):  # the first once more: buffers grow
        began = time.process_time()
        render_view_image(scene, trained.gaussians, index, background, renderer)
        times.append(1e3 * (time.process_time() - began) / _core.num_threads())
    return {
        "num_gaussians": len(trained.gaussians),
        "megabytes": (run / "scene.ply").stat().st_size / 1e6,
        "psnr": figures["psnr"],
        "ssim": figures["ssim"],
        "render_ms": statistics.median(times[1:]),
    }


BENCHMARK = Benchmark(
    help="compacted models beside ones trained that small for the same work: PSNR, size, speed",
    columns=(
        Column("data"),
        Column("method"),
        Column("keep"),
        Column("num_gaussians", "Gaussians", form=",d"),
        Column("megabytes", "PLY", "MB", ".1f"),
        Column("psnr", "held-out PSNR", "dB", ".2f"),
        Column("ssim", "SSIM", form=".4f"),
        Column("render_ms", "a view", "CPU-ms", ".1f"),
        Column("cpu_seconds", "from the photographs on", "CPU-s", ".0f"),
        Column("seconds", "from the photographs on", "s", ".0f"),
    ),
    cases=list_cases,
    measure=measure,
    options=(
        Option("methods", ("ghap",), f"of {', '.join(METHODS)}"),
        Option("keep", (0.1, 0.3), "shares of the Gaussians"),
        Option("finetune", 300, "steps after the compaction"),
        Option("steps", 600, "of the whole model"),
        Option("cap", 100_000, "most Gaussians of the whole model"),
        Option("scale", 0.5, "of the images"),
    ),
)
