"""`./run bench refine`: poses and lens disturbed, and how far training brings them back."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np

import gsut
from disturbances import (
    DISTURBANCES,
    Disturbance,
    disturb_scene,
    jitter_points,
    measure_lens_errors,
)
from gsut._core import InputError
from gsut.data import Scene
from gsut.refine import evaluate_aligned
from gsut.refine.trust import measure_lens_distance
from gsut.sfm import PoseErrors, compare_poses
from tests.bench.harness import HALL, Benchmark, Column, Option, Row, Settings

_MILLIMETRES = 1000.0  # in a unit of the world, which is taken for a metre


def list_cases(settings: Settings) -> Iterator[Row]:
    """Lists the truth, and each disturbance without and with refinement."""
    known = {each.name: each for each in DISTURBANCES}
    unknown = [name for name in settings.disturbances if name not in known]
    if unknown:
        raise InputError(f"--disturbances takes {', '.join(known)}; found {unknown[0]!r}")
    for data in settings.sets or (HALL, "sponza_fisheye"):
        yield {"data": data, "disturbed": "nothing", "training": "plain", "_by": None}
        for name in settings.disturbances:
            for training in ("plain", "refined"):
                text = _describe(known[name])
                yield {"data": data, "disturbed": text, "training": training, "_by": known[name]}


def _describe(by: Disturbance) -> str:
    if by.of_lens:
        return f"focal {100 * by.focal:g} %, k1 {100 * by.first_coefficient:g} %"
    return f"{by.degrees:g} degrees, {100 * by.distance:g} cm"


def measure(case: Row, settings: Settings) -> Row:
    """Trains from the disturbed scene and compares with the truth."""
    truth = gsut.load_dataset(settings.path(case["data"]))
    truth = jitter_points(truth, settings.jitter, 0)
    by, refined = case["_by"], case["training"] == "refined"
    start = truth if by is None else disturb_scene(truth, by, 0)
    options = gsut.TrainOptions(
        steps=settings.steps, max_gaussians=settings.max_gaussians, sh_degree=1,
        scale=settings.scale, checkpoint_every=0, refine_poses=refined,
        refine_lens=refined and by.of_lens,
    )  # fmt: skip
    began, cpu = time.perf_counter(), time.process_time()
    result = gsut.train(start, options, progress=False)
    seconds, cpu = time.perf_counter() - began, time.process_time() - cpu
    figures = result.metrics
    if "alignment" not in figures:
        _, figures = evaluate_aligned(result.gaussians, result.scene, truth.test_indices)
    errors = _compare(result.scene, truth)
    focal, first = measure_lens_errors(result.scene, truth)
    return {
        "rotation_degrees": float(np.median(errors.rotation_degrees)),
        "position_mm": _MILLIMETRES * float(np.median(errors.center_distances)),
        "focal_percent": 100 * focal,
        "k1_percent": None if np.isnan(first) else 100 * first,
        "lens_px": measure_lens_distance(result.scene.file_cameras[0], truth.file_cameras[0]),
        "psnr": figures["alignment"]["psnr_after"],
        "seconds": seconds,
        "cpu_seconds": cpu,
    }


def _compare(scene: Scene, truth: Scene) -> PoseErrors:
    """Compares the training views after the best similarity."""
    poses = [each.poses(truth.train_indices) for each in (scene, truth)]
    return compare_poses(*poses)


BENCHMARK = Benchmark(
    help="what is left of disturbed poses and lenses after training, with and without refinement",
    columns=(
        Column("data"),
        Column("disturbed"),
        Column("training"),
        Column("rotation_degrees", "rotation left", "degrees", ".3f"),
        Column("position_mm", "position left", "mm", ".1f"),
        Column("focal_percent", "focal length left", "%", ".3f"),
        Column("k1_percent", "k1 left", "%", ".1f"),
        Column("lens_px", "lens left", "px", ".3f"),
        Column("psnr", "held-out PSNR", "dB", ".2f"),
        Column("seconds", "training", "s", ".0f"),
        Column("cpu_seconds", "training", "CPU-s", ".0f"),
    ),
    cases=list_cases,
    measure=measure,
    options=(
        Option("disturbances", tuple(each.name for each in DISTURBANCES), "small, large, lens"),
        Option("steps", 1000, "of each training"),
        Option("max_gaussians", 50_000, "of each training"),
        Option("scale", 1.0, "of the images"),
        Option("jitter", 0.02, "standard deviation put on the points, units"),
    ),
)
