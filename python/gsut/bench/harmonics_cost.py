"""What harmonics cost that are not stored: python -m gsut.bench.harmonics_cost 100000 640 480"""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from typing import Any

import numpy as np

from gsut import _core
from gsut._core import InputError

# all: every Gaussian of degree 3. zeros: of mixed degrees, zeros stored. mixed: not stored.
KINDS = ("all", "zeros", "mixed")
# Fractions of degree 0 to 3 where nothing else is asked for.
DEFAULT_SHARES = (0.7, 0.15, 0.1, 0.05)
_SEED = 5


def harmonics_cost(
    count: int,
    width: int,
    height: int,
    *,
    shares: Sequence[float] = DEFAULT_SHARES,
    repeats: int = 10,
) -> list[dict[str, Any]]:
    """Time and memory of rendering and of training steps, each kind in a process of its own.

    Args:
        count: Gaussians of the synthetic room.
        width, height: of the image, pixels.
        shares: of degree 0, 1, 2 and 3, drawn by lot.
        repeats: training steps; the shortest time of each stage counts.

    Returns:
        One row a kind of `KINDS`: forward_ms (of which records_ms make the colours), backward_ms,
        step_ms (of which adam_ms), processor time over threads; sh_mb, the harmonics alone, and
        scene_mb, all parameters, both without gradients and moments; resident_mb of the whole
        process after the steps, with them; and ratio_... to the first row.

    Raises:
        InputError: shares that are not four fractions of 1.
    """
    if len(shares) != 4 or min(shares) < 0 or abs(sum(shares) - 1) > 1e-6:
        raise InputError(f"shares must be four fractions with the sum 1, found {list(shares)}")
    package = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
    environment = os.environ | {"GSUT_ISA": _core.active_isa()}
    environment["PYTHONPATH"] = os.pathsep.join(
        [package, *filter(None, [os.environ.get("PYTHONPATH")])]
    )
    rows = []
    for kind in KINDS:
        task = json.dumps([kind, count, width, height, list(shares), repeats])
        done = subprocess.run(
            [sys.executable, "-m", __spec__.name, "--one", task],
            capture_output=True, text=True, env=environment, check=False,
        )  # fmt: skip
        if done.returncode != 0:
            raise InputError(f"{kind}: {done.stderr.strip().splitlines()[-1:]}")
        rows.append(json.loads(done.stdout))
    for row in rows:
        for key in ("forward_ms", "records_ms", "step_ms", "adam_ms", "sh_mb", "resident_mb"):
            row[f"ratio_{key}"] = row[key] / rows[0][key]
    return rows


def _measure(
    kind: str, count: int, width: int, height: int, shares: Sequence[float], repeats: int
) -> dict[str, Any]:
    from gsut.bench.measure import BACKWARD_STAGES, FORWARD_STAGES, step_loop, step_times
    from gsut.bench.scenes import dense_sigma_pixels, synthetic_scene
    from gsut.gaussians import mixed

    sigma = dense_sigma_pixels(count, width, height)
    scene: Any = synthetic_scene(count, width, height, sigma_pixels=sigma)
    if kind != "all":
        degrees = np.random.default_rng(_SEED).choice(4, count, p=list(shares))
        for degree in range(3):
            scene.gaussians.sh[degrees == degree, (degree + 1) ** 2 :] = 0.0
        if kind == "mixed":
            scene = dataclasses.replace(scene, gaussians=mixed(scene.gaussians, degrees))
    g: Any = scene.gaussians
    arrays = (g.means, g.quats, g.log_scales, g.opacity_logits, g.sh)
    sh_bytes, scene_bytes = g.sh.nbytes, sum(a.nbytes for a in arrays)
    loop = step_loop(scene, repeats)
    del scene, g, arrays  # the loop has its own
    times = step_times(loop, repeats)
    return {
        "kind": kind, "num_gaussians": count, "width": width, "height": height,
        "isa": _core.active_isa(), "threads": _core.num_threads(),
        "forward_ms": times.cpu_ms(*FORWARD_STAGES), "records_ms": times.cpu_ms("records"),
        "backward_ms": times.cpu_ms(*BACKWARD_STAGES), "gradients_ms": times.cpu_ms("gradients"),
        "step_ms": times.cpu_ms("step"), "adam_ms": times.cpu_ms("adam"),
        "sh_mb": sh_bytes / 1e6, "scene_mb": scene_bytes / 1e6, "resident_mb": _resident_mb(),
    }  # fmt: skip


def _resident_mb() -> float:
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


if __name__ == "__main__":
    if sys.argv[1] == "--one":
        print(json.dumps(_measure(*json.loads(sys.argv[2]))))
    else:
        for row in harmonics_cost(*(int(word) for word in sys.argv[1:])):
            print(json.dumps(row))
