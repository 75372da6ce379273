"""`gsut bench refine`: poses and lens put off, and how far training brings them back."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from gsut._core import InputError, SolveError
from gsut.alignment import evaluate_aligned
from gsut.bench.refine_disturb import (
    DISTURBANCES,
    Disturbance,
    disturbed,
    disturbed_pose,
    jittered_points,
    lens_errors,
)
from gsut.data.load import load_dataset
from gsut.data.scene import Scene
from gsut.gaussians import Gaussians
from gsut.options import TrainOptions
from gsut.refine import refine_pose
from gsut.refine_motion import pose_changes
from gsut.structure.align import PoseErrors, compare_poses
from gsut.train import train

# (heading, key of the row, format)
REFINE_COLUMNS = (
    ("disturbed", "disturbed", ""),
    ("training", "training", ""),
    ("rotation start [deg]", "rotation_start_degrees", ".4f"),
    ("end", "rotation_degrees", ".4f"),
    ("position start [mm]", "position_start_mm", ".2f"),
    ("end [mm]", "position_mm", ".2f"),
    ("focal [%]", "focal_percent", ".4f"),
    ("k1 [%]", "k1_percent", ".2f"),
    ("PSNR as given", "psnr_before", ".2f"),
    ("re-aligned [dB]", "psnr", ".2f"),
    ("of truth [dB]", "psnr_to_truth", "+.2f"),
    ("training [s]", "train_seconds", ".1f"),
    ("all [s]", "seconds", ".1f"),
    ("CPU [s]", "cpu_seconds", ".1f"),
)
BASIN_COLUMNS = (
    ("disturbance [deg]", "degrees", "g"),
    ("[m]", "distance", "g"),
    ("views", "views", "d"),
    ("come back", "share", ".2f"),
)
BASIN_DEGREES = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0)
# World units a degree, as in the disturbances; and what counts as come back.
_BASIN_DISTANCE = 0.04
_BASIN_DEGREES, _BASIN_UNITS = 0.1, 0.01
_MILLIMETRES = 1000.0  # in a world unit, which is taken for a metre


@dataclasses.dataclass(frozen=True)
class RefineBenchOptions:
    """What is measured.

    Args:
        data: a dataset whose poses, and lens, are the truth.
        cases: names of DISTURBANCES.
        steps, gaussians, scale, threads, seed: of the training.
        jitter: of the dataset's points, world units, one sigma.
        tracks: begin refinement with tracks of features.
        basin: degrees of the basin's disturbances; empty: none.
    """

    data: str
    cases: Sequence[str] = tuple(each.name for each in DISTURBANCES)
    steps: int = 1000
    gaussians: int = 50_000
    scale: float = 1.0
    threads: int = 0
    seed: int = 0
    jitter: float = 0.02
    tracks: bool = True
    basin: Sequence[float] = BASIN_DEGREES

    def __post_init__(self) -> None:
        known = [each.name for each in DISTURBANCES]
        for name in self.cases:
            if name not in known:
                raise InputError(f"--cases takes {', '.join(known)}; found {name!r}")


def num_parts(options: RefineBenchOptions) -> int:
    """How often `refine_bench` tells its progress."""
    return 1 + 2 * len(options.cases) + len(options.basin)


def refine_bench(
    options: RefineBenchOptions,
    on_progress: Callable[[str], None],
    on_row: Callable[[list[dict[str, Any]]], None] = lambda rows: None,
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Rows of training with the truth, and with each disturbance without and with refinement.

    Args:
        options: see RefineBenchOptions.
        on_progress: told what begins.
        on_row: given all rows so far, after each.

    Returns:
        Rows of REFINE_COLUMNS, and rows of BASIN_COLUMNS: the share of test views that
        `refine_pose` brings back to 0.1 degrees and 0.01 units in the scene of the truth.
    """
    truth = load_dataset(options.data)
    if not truth.test_indices:
        raise InputError(f"{truth.path} has no held-out views to judge by")
    truth = jittered_points(truth, options.jitter, options.seed)
    settings = _settings(options)
    on_progress("true poses")
    row, gaussians, scene = _measure(truth, truth, settings, "nothing", "plain")
    rows = [row]
    on_row(rows)
    for by in [each for each in DISTURBANCES if each.name in options.cases]:
        start = disturbed(truth, by, options.seed)
        for refined in (False, True):
            on_progress(f"{by.name}, {'refined' if refined else 'plain'}")
            chosen = settings
            if refined:
                chosen = dataclasses.replace(
                    settings, refine_poses=True, refine_lens=by.of_lens,
                    refine_tracks=options.tracks,
                )  # fmt: skip
            row, _, _ = _measure(start, truth, chosen, _text(by), "refined" if refined else "plain")
            row["psnr_to_truth"] = row["psnr"] - rows[0]["psnr"]
            rows.append(row)
            on_row(rows)
    basin = []
    for degrees in options.basin:
        on_progress(f"basin, {degrees:g} degrees")
        basin.append(_basin_row(gaussians, scene, degrees, options.seed))
    return rows, basin


def _settings(options: RefineBenchOptions) -> TrainOptions:
    return TrainOptions(
        steps=options.steps,
        max_gaussians=options.gaussians,
        sh_degree=1,
        scale=options.scale,
        threads=options.threads,
        seed=options.seed,
        eval_every=0,
        checkpoint_every=0,
    )


def _text(by: Disturbance) -> str:
    if by.of_lens:
        return f"focal {100 * by.focal:g} %, k1 {100 * by.first_coefficient:g} %"
    return f"{by.degrees:g} deg, {100 * by.distance:g} cm"


def _measure(
    start: Scene, truth: Scene, settings: TrainOptions, name: str, training: str
) -> tuple[dict[str, Any], Gaussians, Scene]:
    """One training; its row, Gaussians and scene with the poses that it ended with."""
    began, cpu = time.perf_counter(), time.process_time()
    result = train(start, settings, progress=False)
    seconds, cpu = time.perf_counter() - began, time.process_time() - cpu
    evaluation = result.metrics
    if "alignment" not in evaluation:
        _, evaluation = evaluate_aligned(result.gaussians, result.scene, truth.test_indices)
    before, after = _errors(start, truth), _errors(result.scene, truth)
    focal, first = lens_errors(result.scene, truth)
    row = {
        "disturbed": name,
        "training": training,
        "rotation_start_degrees": float(np.median(before.rotation_degrees)),
        "rotation_degrees": float(np.median(after.rotation_degrees)),
        "rotation_max_degrees": float(after.rotation_degrees.max()),
        "position_start_mm": _MILLIMETRES * float(np.median(before.center_distances)),
        "position_mm": _MILLIMETRES * float(np.median(after.center_distances)),
        "focal_percent": 100 * focal,
        "k1_percent": 100 * first,
        "psnr_before": evaluation["alignment"]["psnr_before"],
        "psnr": evaluation["alignment"]["psnr_after"],
        "psnr_to_truth": 0.0,
        "train_seconds": result.metrics["train_seconds"],
        "seconds": seconds,
        "cpu_seconds": cpu,
        "refinement": result.metrics.get("refinement"),
    }
    return row, result.gaussians, result.scene


def _errors(scene: Scene, truth: Scene) -> PoseErrors:
    """Of the training views, after the best similarity."""
    poses = [
        np.array([each.views[index].camera_from_world for index in truth.train_indices])
        for each in (scene, truth)
    ]
    return compare_poses(*poses)


def _basin_row(gaussians: Gaussians, scene: Scene, degrees: float, seed: int) -> dict[str, Any]:
    """Test views put off by so much, and the share that their colours bring back."""
    rng = np.random.default_rng([seed, 2, round(1000 * degrees)])
    distance = _BASIN_DISTANCE * degrees
    back = 0
    for index in scene.test_indices:
        true = scene.views[index].camera_from_world
        start = disturbed_pose(rng, true, degrees, distance)
        try:
            found = refine_pose(
                gaussians, scene.camera(index), start, scene.image(index), scene.mask(index)
            )
        except SolveError:
            continue
        change = pose_changes(found.camera_from_world[None], true[None])
        back += bool(change.degrees[0] <= _BASIN_DEGREES and change.distances[0] <= _BASIN_UNITS)
    return {
        "degrees": degrees,
        "distance": distance,
        "views": len(scene.test_indices),
        "share": back / len(scene.test_indices),
    }
