"""What the dearest lens costs a render once the rays of its pixels are cached."""

from __future__ import annotations

import dataclasses
from typing import Any

from gsut import _core
from gsut.bench.measure import FORWARD_STAGES, FastRun, best_times
from gsut.bench.scenes import make_scene
from gsut.cameras import Camera

# A grid of control points that are all zero, cubic: the spline is evaluated in full, and the image
# is the stereographic one.
_ORDER, _COLUMNS, _ROWS, _FOV_DEGREES = 3, 16, 12, 140.0


def lens_cost_row(repeats: int = 10) -> dict[str, Any]:
    """Forward and backward through a splined lens, beside a pinhole of the same scale on the axis.

    The two see slightly different fields, so times are also given a (tile, Gaussian) pair.
    """
    scene = make_scene("synthetic_100k_640x480")
    width, height = scene.camera.width, scene.camera.height
    focal = [float(width), float(width), 0.5 * width, 0.5 * height]
    spline = [_ORDER, _COLUMNS, _ROWS, _FOV_DEGREES, *focal, *([0.0] * (2 * _COLUMNS * _ROWS))]
    cameras = {
        "pinhole": Camera("pinhole", focal, width, height),
        "splined": Camera("splined_stereographic", spline, width, height),
    }
    row: dict[str, Any] = {"name": "lens_cost_100k_640x480", "isa": _core.active_isa()}
    for name, camera in cameras.items():
        run = FastRun(dataclasses.replace(scene, camera=camera), _core.BlendRule())
        times = best_times(run.once, repeats)
        pairs = run.renderer.statistics()["num_pairs"]
        forward = times.wall_ms(*FORWARD_STAGES)
        total = forward + times.wall_ms("backward", "gradients")
        row[name] = {
            "project_ms": times.wall_ms("project"), "forward_ms": forward,
            "forward_backward_ms": total, "num_pairs": pairs, "ns_per_pair": 1e6 * total / pairs,
        }  # fmt: skip
    for key in ("forward_ms", "forward_backward_ms", "ns_per_pair"):
        row[f"splined_over_pinhole_{key}"] = row["splined"][key] / row["pinhole"][key]
    return row
