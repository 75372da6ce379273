"""What the most expensive lens costs a render once the rays of its pixels are cached."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from gsut import _core
from gsut.lens import Camera, SplineGrid, convert_camera
from tests.bench.measure import BACKWARD_STAGES, FORWARD_STAGES, FastRun, Times, best_times
from tests.bench.scenes import make_scene

_GRID = SplineGrid(order=3, columns=16)


def lens_cost_row(repeats: int = 20) -> dict[str, Any]:
    """Forward and backward through a pinhole and through a splined lens fitted to it.

    Both show the same image (`fit_px`: the largest distance of their pixels), and runs alternate.
    Times are the shortest of `repeats`, processor time over threads, which a busy machine changes
    least; `ratio_...` are splined over pinhole.
    """
    scene = make_scene("synthetic_100k_640x480")
    width, height = scene.camera.width, scene.camera.height
    pinhole = Camera("pinhole", [width, width, 0.5 * width, 0.5 * height], width, height)
    splined = convert_camera(pinhole, "splined_stereographic", grid=_GRID).camera
    rays, valid = pinhole.rays()
    places = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1) + 0.5
    fit = np.abs(splined.project(rays[valid])[0] - places[valid]).max()
    runs = {
        name: FastRun(dataclasses.replace(scene, camera=camera), _core.BlendRule())
        for name, camera in (("pinhole", pinhole), ("splined", splined))
    }
    best: dict[str, Times] = {}
    for turn in range(1 + repeats):
        for name, run in runs.items():
            now = best_times(run.once, 1, warmups=0)
            # The first turn builds the rays.
            best[name] = now if turn < 2 else _shortest(best[name], now)
    row: dict[str, Any] = {
        "name": "lens_cost_100k_640x480", "isa": _core.active_isa(),
        "threads": _core.num_threads(), "fit_px": float(fit),
    }  # fmt: skip
    stages = {
        "project": ("project",),
        "forward": FORWARD_STAGES,
        "forward_backward": (*FORWARD_STAGES, *BACKWARD_STAGES),
    }
    for name, times in best.items():
        row[name] = {f"{key}_cpu_ms": times.cpu_ms(*names) for key, names in stages.items()}
        row[name]["num_pairs"] = runs[name].renderer.statistics()["num_pairs"]
    for key in stages:
        above, below = (row[name][f"{key}_cpu_ms"] for name in ("splined", "pinhole"))
        row[f"ratio_{key}"] = above / below
    row["ratio_pairs"] = row["splined"]["num_pairs"] / row["pinhole"]["num_pairs"]
    return row


def _shortest(a: Times, b: Times) -> Times:
    return Times(
        {
            stage: (min(wall, b.stages[stage][0]), min(cpu, b.stages[stage][1]))
            for stage, (wall, cpu) in a.stages.items()
        },
        a.repeats + b.repeats,
    )
