"""`./run bench approximations`: what orders and responses cost against the exact integral."""

from __future__ import annotations

import shlex
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import gsut
from gsut import _core
from gsut.gaussians import Gaussians
from tests.bench.commands import train
from tests.bench.harness import HALL, Benchmark, Column, Option, Row, Settings

ORDERS = ("z", "distance", "ray")
# A frame of a path: what a film of 30 frames a second shows of a slow turn, and of a slow walk.
_TURN_DEGREES = 1.0
_STEP_UNITS = 0.01
_PATCH = 4  # pixels across a patch: what swaps as a whole, an eye sees
_SEED = 0
_TIMED = 5  # renders of a view, of which the fastest counts


def list_cases(settings: Settings) -> Iterator[Row]:
    """Lists numbers of Gaussians, responses that are trained with, and orders."""
    for name in settings.sets or (HALL,):
        for count in settings.counts:
            for response in settings.responses:
                for order in ORDERS:
                    yield {
                        "data": name, "count": f"{count:,}", "response": response, "order": order,
                        "_count": count,
                    }  # fmt: skip


def measure(case: Row, settings: Settings) -> Row:
    """Trains, unless it was done, and compares one order with the integral of the same model."""
    count, response, order = case["_count"], case["response"], case["order"]
    data = settings.path(case["data"])
    run = settings.folder / f"{data.name}-{count}-{response}"
    flags = f"{settings.flags} --max-gaussians {count} --response {response}"
    metrics = train(data, run, shlex.split(flags))
    model = gsut.load_gaussians(run / "scene.ply")
    views = _choose_views(data, settings.views)
    truth, found, jumps = [], [], {"turn": [], "step": []}
    for number, (camera, pose) in enumerate(views):
        lines = _sample_lines(camera, pose, settings.patches, number)
        g = _take_plain_colors(model)
        truth.append(_integrate(run, number, g, lines, pose))
        found.append(_draw(g, lines, pose, order))
        for motion, moved in _move(pose).items():
            if order == "ray":
                continue
            there = _sample_lines(camera, moved, settings.patches, number)
            jump = _draw(g, there, moved, order) - _draw(g, there, pose, order)
            jumps[motion].append(jump.mean(axis=1))
    off = np.concatenate(found) - np.concatenate(truth)
    return {
        "psnr": metrics["psnr"] if order == "distance" else None,
        "num_gaussians": len(model),
        "error_db": -10 * np.log10(np.mean(off**2)),
        "error_rare": float(np.quantile(np.abs(off), 0.999)),
        "forward_ms": None if order == "ray" else _time_forward(model, views, order),
        **{f"{name}_rms": _find_rms(values) for name, values in jumps.items()},
        **{f"{name}_largest": _find_largest(values) for name, values in jumps.items()},
    }


def _find_rms(values: list[np.ndarray]) -> float | None:
    return float(np.sqrt(np.mean(np.concatenate(values) ** 2))) if values else None


def _find_largest(values: list[np.ndarray]) -> float | None:
    return float(np.abs(np.concatenate(values)).max()) if values else None


def _choose_views(data: Path, most: int) -> list[tuple[gsut.Camera, np.ndarray]]:
    """Chooses held-out views, evenly."""
    scene = gsut.load_dataset(data)
    rows = np.unique(np.linspace(0, len(scene.test_indices) - 1, most).astype(int))
    chosen = [scene.test_indices[row] for row in rows]
    return [(scene.camera(i), scene.views[i].camera_from_world) for i in chosen]


def _take_plain_colors(model: Gaussians) -> Gaussians:
    """Takes the colours without harmonics: what changes with the pose is the order alone."""
    plain = Gaussians(
        model.means, model.quats, model.log_scales, model.opacity_logits, model.sh[:, :1],
        model.origin, response=model.response,
    )  # fmt: skip
    return plain.with_origin((0.0, 0.0, 0.0)).to_dtype(np.float64)


def _sample_lines(camera: gsut.Camera, pose: np.ndarray, patches: int, seed: int) -> np.ndarray:
    """Samples (patches, 16, 6) lines in the world: the pixels of patches at random."""
    rays, valid = camera.rays()
    rng = np.random.default_rng([_SEED, seed])
    lines = np.zeros((patches, _PATCH**2, 6))
    lines[..., :3] = -pose[:3, :3].T @ pose[:3, 3]
    for patch in range(patches):
        while True:
            row, column = (
                int(rng.integers(0, side - _PATCH)) for side in (camera.height, camera.width)
            )
            window = np.s_[row : row + _PATCH, column : column + _PATCH]
            if valid[window].all():
                break
        lines[patch, :, 3:] = rays[window].reshape(-1, 3) @ pose[:3, :3]
    return lines


def _move(pose: np.ndarray) -> dict[str, np.ndarray]:
    """Moves a camera by a frame: a turn about its own vertical, a step to its right."""
    angle = np.radians(_TURN_DEGREES)
    turn, step = np.eye(4), np.eye(4)
    turn[[0, 0, 2, 2], [0, 2, 0, 2]] = np.cos(angle), np.sin(angle), -np.sin(angle), np.cos(angle)
    step[0, 3] = -_STEP_UNITS
    return {"turn": turn @ pose, "step": step @ pose}


def _draw(g: Gaussians, lines: np.ndarray, ordered_from: np.ndarray, order: str) -> np.ndarray:
    """Draws lines (P, 16, 6) in double; Gaussians are in the order seen from a pose."""
    rule = _core.BlendRule()
    rule.order = order
    return _core.render_lines_reference(g, lines, ordered_from, rule)[0]


def _integrate(
    run: Path, number: int, g: Gaussians, lines: np.ndarray, pose: np.ndarray
) -> np.ndarray:
    """Integrates along lines, unless it was done: it takes longer than all the rest."""
    path = run / f"integral-{number}-{len(lines)}.npy"
    if not path.is_file():
        np.save(path, _draw(g, lines, pose, "integral"))
    return np.load(path)


def _time_forward(
    model: Gaussians, views: list[tuple[gsut.Camera, np.ndarray]], order: str
) -> float:
    """Measures the processor milliseconds of blending one view, over the threads."""
    renderer, rule = _core.Renderer(), _core.BlendRule()
    rule.order = order
    g, times = model.with_origin((0.0, 0.0, 0.0)), []
    for camera, pose in views:
        image = np.zeros((camera.height, camera.width, 3), np.float32)
        job = _core.RenderJob(camera, pose, rule=rule, sh_degree=g.sh_degree)
        least = np.inf
        for _ in range(_TIMED):
            renderer.render(g, job, image)
            least = min(least, renderer.timings()["forward"][1])
            time.sleep(0)  # lets another process end its slice between two
        times.append(least)
    return 1e3 * float(np.mean(times)) / _core.num_threads()


BENCHMARK = Benchmark(
    help="error of each order and response against the exact integral of the same Gaussians",
    columns=(
        Column("data"),
        Column("count", "Gaussians"),
        Column("response"),
        Column("order"),
        Column("psnr", "held-out PSNR", "dB", ".2f"),
        Column("error_db", "against the integral", "dB", ".1f"),
        Column("error_rare", "1 of 1000 values off by", form=".3f"),
        Column("turn_rms", "swaps of a turn, rms", form=".1e"),
        Column("turn_largest", "largest", form=".3f"),
        Column("step_rms", "swaps of a step, rms", form=".1e"),
        Column("step_largest", "largest ", form=".3f"),
        Column("forward_ms", "blend", "CPU-ms", ".1f"),
    ),
    cases=list_cases,
    measure=measure,
    options=(
        Option("counts", (20_000, 50_000), "numbers of Gaussians"),
        Option("responses", ("maximum", "extinction"), "to train with"),
        Option("flags", "--preset fast", "of gsut train"),
        Option("views", 3, "held-out views"),
        Option("patches", 24, "of 4 x 4 pixels a view"),
    ),
)
