"""Trains on estimated poses, and judges the verdict of the scene by views between the pictures."""

from __future__ import annotations

import json
import statistics
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

import gsut
from gsut._core import interpolate_pose
from gsut.evaluate.detail import measure_detail
from gsut.judge.checks import combine_verdicts
from gsut.run import Verdict
from lab.proving.capture import Capture
from lab.proving.commands import run_training
from lab.proving.truth import ON_ITS_SIDE, classify_scene
from lab.proving.writing import trace_views

_VIEWS = 6  # between pictures, along the whole path
_STANDING = 1e-6  # metres: cameras that are nearer stand at one place, and have no scale

Poses = Mapping[int, np.ndarray]  # camera_from_world (4, 4) by number of the picture


def score_scene(
    made: Capture, poses: Path, found: Poses, registered: float, work: Path
) -> dict[str, Any]:
    """Trains on what `gsut poses` wrote, and asks what shows between the pictures.

    Args:
        made: the capture.
        poses: the dataset.
        found: its poses.
        registered: share of the pictures that have one.
        work: an existing folder.

    Returns:
        The verdict that `gsut scene` gives, and what it should have been: see `classify_scene`.
    """
    out = work / "scene"
    outcome, metrics = run_training(poses, out, "--preset", "fast", work=work)
    row: dict[str, Any] = {
        "scene_status": outcome.status, "scene_seconds": outcome.cpu_seconds,
        "scene_traceback": outcome.errors[-2000:] if outcome.has_traceback else None,
    }  # fmt: skip
    if not metrics:
        return row | {"scene_refused": outcome.last_line}
    figures = json.loads((poses / "poses.json").read_text("utf-8"))
    trained, estimated = (Verdict.from_dict(each["verdict"]) for each in (metrics, figures))
    verdict = combine_verdicts(trained, estimated)
    shown = _measure_middles(made, poses, found, out)
    between, beside = (statistics.median(each) if each else None for each in shown)
    return row | {
        "scene_verdict": verdict.level, "scene_reasons": list(verdict.reasons),
        "scene_trained": trained.level, "scene_hidden": estimated.hidden_level,
        "scene_psnr": metrics.get("psnr"),
        "scene_held_out": metrics.get("detail_median"),
        "scene_between": between, "scene_beside": beside,
        "scene_class": classify_scene(between, registered),
    }  # fmt: skip


def _measure_middles(
    made: Capture, poses: Path, found: Poses, run: Path
) -> tuple[list[float], list[float]]:
    """Measures the detail that is right midway between pictures.

    Returns:
        By views midway between the estimated poses, which show what a visitor sees; and by views
        that are as far from the picture before as the truth says, in the estimated world's unit:
        there a bent world, a wrong lens and a drifting unit show too.
    """
    numbers = sorted(found)
    if len(numbers) < 2:
        return [], []
    truth = {k: np.linalg.inv(made.path(made.times[[k]])[0]) for k in numbers}
    unit = _measure_unit(found, truth)
    camera = gsut.load_dataset(poses, test_every=0).cameras[0]
    gaussians = gsut.load_gaussians(run / "scene.ply")
    side = ON_ITS_SIDE if made.told.turned else np.eye(4)
    places = np.linspace(0, len(numbers) - 2, min(_VIEWS, len(numbers) - 1)).round().astype(int)
    ends = [(numbers[place], numbers[place + 1]) for place in places]
    middles = [interpolate_pose(truth[one], truth[other], 0.5) for one, other in ends]
    views = trace_views(made, [np.linalg.inv(middle) for middle in middles])
    between, beside = [], []
    for (one, other), middle, (picture, inside) in zip(ends, middles, views, strict=True):
        step = middle @ np.linalg.inv(truth[one])
        step[:3, 3] *= unit
        own = interpolate_pose(found[one], found[other], 0.5)
        for pose, details in ((own, between), (step @ found[one], beside)):
            image = np.clip(gsut.render(gaussians, camera, side @ pose).image, 0, 1)
            image = np.rot90(image, -1) if made.told.turned else image
            shown = slice(0, image.shape[0]), slice(0, image.shape[1])  # films have even sizes
            details.append(measure_detail(picture[shown], image, inside[shown]))
    return between, beside


def _measure_unit(found: Poses, truth: Poses) -> float:
    """Measures the estimated world's length of a metre, by the distances between the cameras."""
    ratios = []
    for a in found:
        for b in found:
            lengths = [_measure_step(poses[a], poses[b]) for poses in (found, truth)]
            if a < b and lengths[1] > _STANDING:
                ratios.append(lengths[0] / lengths[1])
    return statistics.median(ratios) if ratios else 1.0


def _measure_step(first: np.ndarray, second: np.ndarray) -> float:
    return float(np.linalg.norm((second @ np.linalg.inv(first))[:3, 3]))
