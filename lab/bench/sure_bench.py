"""`lab/run bench sure`: where renders say that they err, beside where they do."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np

import gsut
from gsut.compact import list_seen_views, measure_confidence
from gsut.compact.methods.pup import score_sensitivity
from gsut.data.scene import read_depth
from tests.bench.commands import train
from tests.bench.harness import HALL, Benchmark, Column, Option, Row, Settings

_MOST_VIEWS = 12  # held-out views that are judged, spread evenly
_LEAST = 1e-9


def list_cases(settings: Settings) -> Iterator[Row]:
    """Lists the datasets."""
    for data in settings.sets or (HALL, "sponza_fisheye", "helmet_distorted_rs", "fox"):
        yield {"data": data}


def measure(case: Row, settings: Settings) -> Row:
    """Trains, measures the confidence, and sorts pixels of held-out views by it."""
    out = settings.folder / f"sure-{case['data'].replace('/', '_')}"
    words = ["--steps", str(settings.steps), "--max-gaussians", str(settings.cap)]
    words += ["--max-side", str(settings.side)]
    took = train(settings.path(case["data"]), out, words)
    run = gsut.load_run(out)
    began = time.process_time()
    confidence = measure_confidence(
        run.scene, run.gaussians, background=run.options.background, light=run.light
    )
    seconds = time.process_time() - began
    colors, depths = collect_pixels(run, confidence)
    one_sigma = list(confidence.levels).index(0.68)
    of_views = 100 * confidence.held_by_view[:, one_sigma]
    return {
        "psnr": took["psnr"],
        **{f"color_{name}": measure_ause(colors["error"], colors[name]) for name in
           ("sigma", "weight", "pup", "random")},
        **({f"depth_{name}": measure_ause(depths["error"], depths[name]) for name in
            ("sigma", "pup")} if len(depths["error"]) else {}),
        "depth_held": 100 * float(np.mean(depths["error"] <= depths["bound"]))
        if len(depths["error"]) else None,
        "held": 100 * confidence.held[one_sigma],
        "held_95": 100 * confidence.held[-1],
        "least": of_views.min(),
        "most": of_views.max(),
        "cpu_seconds": took["cpu_seconds"],
        "pass_seconds": seconds,
    }  # fmt: skip


def collect_pixels(run: gsut.TrainedRun, confidence) -> tuple[Row, Row]:
    """Collects errors and scores of the pixels of held-out views: of colours, and of depths."""
    scene, g = run.scene, run.gaussians
    pup = score_sensitivity(g, list_seen_views(scene, scene.train_indices))
    # Scores of what no view shows are -inf; the range of the others bounds them.
    known = np.isfinite(pup)
    low, high = np.min(pup[known]), np.max(pup[known])
    scores = np.stack([np.where(known, (pup - low) / (high - low), 0.0), confidence.weight], axis=1)
    colors: list[Row] = []
    depths: list[Row] = []
    rng = np.random.default_rng(0)
    tests = scene.test_indices
    for index in tests[:: -(-len(tests) // _MOST_VIEWS)]:
        camera, motion = scene.camera(index), scene.views[index].motion
        look = {"background": run.options.background}
        sure = gsut.render(g, camera, motion, confidence=confidence, **look)
        rival = gsut.render(g, camera, motion, features=scores, **look).features
        image = sure.image
        if run.light is not None:
            image = image * run.light.on(camera, index, scene.views[index].camera_index)
        error = np.abs(np.clip(image, 0, 1) - scene.image(index) / 255.0).mean(axis=2)
        # What was never seen comes first.
        color_sigma = np.nan_to_num(sure.color_sigma, nan=np.inf)
        mask = scene.mask(index)
        colors.append({
            "error": error[mask], "sigma": color_sigma[mask], "pup": -rival[..., 0][mask],
            "weight": -rival[..., 1][mask], "random": rng.uniform(size=np.count_nonzero(mask)),
        })  # fmt: skip
        truth = read_depth(scene, index)
        if truth is None:
            continue
        rows, columns = ((np.arange(n) + 0.5) * m // n for n, m in
                         zip(error.shape, truth.shape, strict=True))  # fmt: skip
        truth = truth[rows.astype(int)][:, columns.astype(int)]
        found = gsut.render_surface(sure).median
        mask = mask & (truth > 0) & np.isfinite(found) & np.isfinite(sure.depth_sigma)
        off, far = np.abs(found - truth)[mask], truth[mask]
        depths.append({
            "error": off / far, "sigma": sure.depth_sigma[mask] / found[mask],
            "bound": sure.depth_sigma[mask] / far, "pup": -rival[..., 0][mask],
        })  # fmt: skip
    return _join(colors), _join(depths)


def _join(parts: list[Row]) -> Row:
    """Joins the pixels of all views."""
    if not parts:
        return {"error": np.zeros(0)}
    return {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}


def measure_ause(errors: np.ndarray, scores: np.ndarray) -> float:
    """Measures the area under the sparsification error, 0: as the errors themselves, 1: useless.

    Args:
        errors: (P,) of pixels.
        scores: (P,) large where an error is expected.
    """

    def area(order: np.ndarray) -> float:
        """Averages the mean error of what is left as pixels leave in this order."""
        kept = np.cumsum(errors[order][::-1]) / np.arange(1, len(errors) + 1)
        return float(kept.mean())

    best = area(np.argsort(-errors, kind="stable"))
    found = area(np.argsort(-scores, kind="stable"))
    return (found - best) / max(float(errors.mean()) - best, _LEAST)


BENCHMARK = Benchmark(
    help="where renders say that they err, beside where they do, and intervals that hold",
    columns=(
        Column("data"),
        Column("psnr", "held-out PSNR", "dB", ".2f"),
        Column("color_sigma", "colour AUSE, sigma", form=".2f"),
        Column("color_weight", "of few pixels", form=".2f"),
        Column("color_pup", "colour, of PUP", form=".2f"),
        Column("color_random", "at random", form=".2f"),
        Column("held", "68 % intervals hold", "%", ".0f"),
        Column("least", "least of a view", "%", ".0f"),
        Column("most", "most", "%", ".0f"),
        Column("held_95", "95 % intervals", "%", ".0f"),
        Column("depth_sigma", "depth AUSE, sigma", form=".2f"),
        Column("depth_pup", "depth, of PUP", form=".2f"),
        Column("depth_held", "a depth's sigma holds", "%", ".0f"),
        Column("pass_seconds", "the pass", "CPU-s", ".1f"),
        Column("cpu_seconds", "training", "CPU-s", ".1f"),
    ),
    cases=list_cases,
    measure=measure,
    options=(
        Option("steps", 1000, "of the training"),
        Option("cap", 30_000, "most Gaussians"),
        Option("side", 240, "longer side of the images, pixels"),
    ),
)
