"""Trains on estimated poses, and judges the verdict of the scene by views beside the pictures."""

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
from gsut.run import Verdict
from gsut.run.verdicts import combine_verdicts
from tests.proving.capture import Capture
from tests.proving.commands import run_gsut
from tests.proving.truth import classify_scene
from tests.proving.writing import trace_views

_VIEWS = 6  # between pictures, along the whole path
_STANDING = 1e-6  # metres: cameras that are nearer stand at one place, and have no scale

Poses = Mapping[int, np.ndarray]  # camera_from_world (4, 4) by number of the picture


def score_scene(
    made: Capture, poses: Path, found: Poses, registered: float, work: Path
) -> dict[str, Any]:
    """Trains on what `gsut poses` wrote, and asks what shows half a step beside the pictures.

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
    outcome = run_gsut("train", poses, "-o", out, "--preset", "fast", "--quiet", work=work)
    row: dict[str, Any] = {
        "scene_status": outcome.status, "scene_seconds": outcome.cpu_seconds,
        "scene_traceback": outcome.errors[-2000:] if outcome.has_traceback else None,
    }  # fmt: skip
    if outcome.status != 0:
        return row | {"scene_refused": outcome.last_line}
    metrics = json.loads((out / "metrics.json").read_text("utf-8"))
    figures = json.loads((poses / "poses.json").read_text("utf-8"))
    trained, estimated = (Verdict.from_dict(each["verdict"]) for each in (metrics, figures))
    verdict = combine_verdicts(trained, estimated)
    beside = _measure_beside(made, poses, found, out)
    detail = statistics.median(beside) if beside else None
    return row | {
        "scene_verdict": verdict.level, "scene_reasons": list(verdict.reasons),
        "scene_trained": trained.level, "scene_hidden": estimated.hidden_level,
        "scene_psnr": metrics.get("psnr"),
        "scene_held_out": metrics.get("detail_median"), "scene_beside": detail,
        "scene_class": classify_scene(detail, registered),
    }  # fmt: skip


def _measure_beside(made: Capture, poses: Path, found: Poses, run: Path) -> list[float]:
    """Measures the detail that is right midway between pictures: away from them as the truth says.

    A view is placed by the estimated pose of the picture before it, in the estimated world's unit,
    so that wrong poses, lens and shapes all show.
    """
    numbers = sorted(found)
    if len(numbers) < 2:
        return []
    truth = {k: np.linalg.inv(made.path(made.times[[k]])[0]) for k in numbers}
    unit = _measure_unit(found, truth)
    camera = gsut.load_dataset(poses, test_every=0).cameras[0]
    gaussians = gsut.load_gaussians(run / "scene.ply")
    rows = min(made.lens.camera.height, camera.height)  # films have even sizes
    columns = min(made.lens.camera.width, camera.width)
    cut = slice(0, rows), slice(0, columns)
    places = np.linspace(0, len(numbers) - 2, min(_VIEWS, len(numbers) - 1)).round().astype(int)
    middles = [
        interpolate_pose(truth[numbers[place]], truth[numbers[place + 1]], 0.5) for place in places
    ]
    views = trace_views(made, [np.linalg.inv(middle) for middle in middles])
    beside = []
    for place, middle, (picture, inside) in zip(places, middles, views, strict=True):
        step = middle @ np.linalg.inv(truth[numbers[place]])
        step[:3, 3] *= unit
        image = gsut.render(gaussians, camera, step @ found[numbers[place]]).image
        beside.append(measure_detail(picture[cut], np.clip(image[cut], 0, 1), inside[cut]))
    return beside


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
