"""`./run bench approximations`: what orders and responses cost against the exact integral."""

from __future__ import annotations

import dataclasses
import shlex
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import gsut
import ray_model
from gsut import _core
from gsut.gaussians import Gaussians
from tests.bench.commands import train
from tests.bench.harness import HALL, Benchmark, Column, Option, Row, Settings

ORDERS = ("z", "distance", "ray")
# A frame of a film: a turn and a walk at 30 frames a second, at the pace of a hand-held camera.
_TURN_DEGREES = 1.0
_STEP_UNITS = 0.01
_PATCH = 4  # pixels across a patch: what swaps as a whole, an eye sees
_SEED = 0
_TIMED = 5  # renders of a view, of which the fastest counts
# Of the exact integral are left out, at a ray: Gaussians that cover less, and those behind so much.
_FAINT = 1e-4
_HIDDEN = 1e-4

Views = list[tuple[gsut.Camera, np.ndarray]]


def list_cases(settings: Settings) -> Iterator[Row]:
    """Lists numbers of Gaussians, responses and orders."""
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
    # No training draws the density: it is of the maximum's model, drawn otherwise.
    trained = "maximum" if response == "density" else response
    run = settings.folder / f"{data.name}-{count}-{trained}"
    flags = f"{settings.flags} --max-gaussians {count} --set response={trained}"
    train(data, run, shlex.split(flags))
    model = dataclasses.replace(gsut.load_gaussians(run / "scene.ply"), response=response)
    scene = gsut.load_dataset(data)
    plain, off = _take_plain_colors(model), []
    jumps: dict[str, list[np.ndarray]] = {"turn": [], "step": []}
    for number, (camera, pose) in enumerate(_choose_views(scene, settings.views)):
        pixels = _sample_patches(camera, settings.patches, number)
        lines, seen = _find_lines(camera, pose, pixels), pixels[: settings.integrals, :1]
        truth = _integrate(run / f"{response}-{number}.npz", plain, camera, pose, seen)
        off.append(_draw(plain, lines[: len(seen), :1], pose, order) - truth)
        for motion, moved in _move(pose).items():
            there = _find_lines(camera, moved, pixels)
            jump = _draw(plain, there, moved, order) - _draw(plain, there, pose, order)
            jumps[motion].append(jump.mean(axis=1))
    errors = np.concatenate(off)
    swaps = {name: np.concatenate(values) for name, values in jumps.items()}
    is_float = response != "density"
    return {
        "psnr": _measure_psnr(model, scene, order) if is_float else None,
        "error_db": -10 * np.log10(np.mean(errors**2)),
        "error_rare": float(np.quantile(np.abs(errors), 0.999)),
        "turn": float(np.abs(swaps["turn"]).max()),
        "step": float(np.abs(swaps["step"]).max()),
        "forward_ms": _time_forward(model, scene, order) if is_float else None,
    }


def _choose_views(scene: gsut.Scene, most: int) -> Views:
    """Chooses held-out views, evenly."""
    rows = np.unique(np.linspace(0, len(scene.test_indices) - 1, most).astype(int))
    chosen = [scene.test_indices[row] for row in rows]
    return [(scene.camera(i), scene.views[i].camera_from_world) for i in chosen]


def _take_plain_colors(model: Gaussians) -> Gaussians:
    """Takes the colours without harmonics: what changes with the pose is the order alone."""
    plain = dataclasses.replace(model, sh=model.sh[:, :1].copy())
    return plain.with_origin((0.0, 0.0, 0.0)).to_dtype(np.float64)


def _sample_patches(camera: gsut.Camera, count: int, seed: int) -> np.ndarray:
    """Samples (count, 16, 2) rows and columns: the pixels of patches at random, all with rays."""
    valid, rng = camera.rays()[1], np.random.default_rng([_SEED, seed])
    offsets = np.stack(np.meshgrid(range(_PATCH), range(_PATCH), indexing="ij"), axis=-1)
    patches: list[np.ndarray] = []
    while len(patches) < count:
        corner = [int(rng.integers(0, side - _PATCH)) for side in (camera.height, camera.width)]
        pixels = corner + offsets.reshape(-1, 2)
        if valid[pixels[:, 0], pixels[:, 1]].all():
            patches.append(pixels)
    return np.stack(patches)


def _find_lines(camera: gsut.Camera, pose: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Finds the lines (P, 16, 6) of patches of pixels in the world: origins and directions."""
    lines = np.zeros((*pixels.shape[:2], 6))
    lines[..., :3] = -pose[:3, :3].T @ pose[:3, 3]
    lines[..., 3:] = camera.rays()[0][pixels[..., 0], pixels[..., 1]] @ pose[:3, :3]
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
    file: Path, g: Gaussians, camera: gsut.Camera, pose: np.ndarray, pixels: np.ndarray
) -> np.ndarray:
    """Integrates along the rays of patches, unless it was done: it takes longer than all else."""
    if not file.is_file():
        colors = []
        for patch in pixels:
            rows = _find_seen(g, camera, pose, patch)
            lines = _find_lines(camera, pose, patch[None])
            colors.append(_draw(g[rows], lines, pose, "integral"))
        np.savez(file, colors=np.concatenate(colors))
    return np.load(file)["colors"]


def _find_seen(
    g: Gaussians, camera: gsut.Camera, pose: np.ndarray, pixels: np.ndarray
) -> np.ndarray:
    """Finds the Gaussians that show at a pixel of a patch, neither faint nor hidden."""
    toward = g.means @ pose[:3, :3].T + pose[:3, 3]
    axis = camera.rays()[0][pixels[:, 0], pixels[:, 1]].mean(axis=0)
    along = toward @ axis / np.linalg.norm(axis)
    # Within six deviations, and a patch's width, of the patch's middle.
    beside = np.linalg.norm(toward - along[:, None] * axis / np.linalg.norm(axis), axis=1)
    widest = np.exp(g.log_scales).max(axis=1)
    near = np.flatnonzero(beside < 6 * widest + 0.1 * np.abs(along))
    traced = ray_model.trace(g[near], camera, pose, gsut.BlendRule(), pixels=pixels)
    order = np.argsort(traced.along, axis=1)
    through = np.cumprod(1 - np.take_along_axis(traced.alpha, order, axis=1), axis=1)
    front = np.ones_like(through)
    np.put_along_axis(front, order[:, 1:], through[:, :-1], axis=1)
    shows = (traced.alpha > _FAINT) & (front > _HIDDEN)
    return near[shows.any(axis=0)]


def _make_rule(order: str) -> _core.BlendRule:
    rule = _core.BlendRule()
    rule.order = order
    return rule


def _measure_psnr(model: Gaussians, scene: gsut.Scene, order: str) -> float:
    """Measures the held-out views, drawn in an order."""
    found = []
    for i in scene.test_indices:
        camera, pose = scene.camera(i), scene.views[i].camera_from_world
        image = gsut.render(model, camera, pose, order=order).image
        mask = camera.rays()[1]
        found.append(gsut.psnr(image, scene.image(i).astype(np.float32) / 255, mask))
    return float(np.mean(found))


def _time_forward(model: Gaussians, scene: gsut.Scene, order: str) -> float:
    """Measures the milliseconds of all threads together that blending a held-out view takes."""
    renderer, rule, times = _core.Renderer(), _make_rule(order), []
    g = model.with_origin((0.0, 0.0, 0.0))
    for i in scene.test_indices:
        camera, pose = scene.camera(i), scene.views[i].camera_from_world
        image = np.zeros((camera.height, camera.width, 3), np.float32)
        job = _core.RenderJob(camera, pose, rule=rule, sh_degree=g.sh_degree, keep=False)
        took = []
        for _ in range(_TIMED):
            renderer.render(g, job, image)
            took.append(renderer.timings()["forward"][1])
        times.append(min(took))
    return 1e3 * float(np.mean(times))


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
        Column("turn", "largest swap of a turn", form=".3f"),
        Column("step", "of a step", form=".3f"),
        Column("forward_ms", "blend", "CPU-ms", ".1f"),
    ),
    cases=list_cases,
    measure=measure,
    options=(
        Option("counts", (20_000, 50_000), "numbers of Gaussians"),
        Option("responses", ("maximum", "extinction", "density"), "of the model"),
        Option("flags", "--preset fast", "of gsut train"),
        Option("views", 3, "held-out views of errors and swaps"),
        Option("patches", 96, "of 4 x 4 pixels a view, whose swaps are measured"),
        Option("integrals", 24, "of them, one pixel each, whose errors are measured"),
    ),
)
