"""`lab/run bench approximations`: what order, response and projection cost against the integral."""

from __future__ import annotations

import dataclasses
import json
import shlex
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

import gsut
import ray_model
from gsut import _core
from gsut.cli import build_parser
from gsut.data.scene import read_depth
from gsut.gaussians import Gaussians
from gsut.render import measure_depth
from gsut.run.options import TrainOptions, collect_given
from lab.bench.approximations_film import draw_lines, film_orders, find_lines, move_camera
from tests.bench.harness import HALL, Benchmark, Column, Option, Row, Settings

ORDERS = ("z", "distance", "ray", "integral")
EXACT = "exact"  # in 3D, along each ray; others are footprints in the picture
FOOTPRINTS = ("ewa", "unscented")
_PATCH = 4  # pixels across a patch: what swaps as a whole, an eye sees
_SEED = 0
_TIMED = 5  # renders of a view, of which the fastest counts
# Of the exact integral are left out, at a ray: Gaussians that cover less, and those behind so much.
_FAINT = 1e-4
_HIDDEN = 1e-4

Views = list[tuple[int, gsut.Camera, np.ndarray]]


def list_cases(settings: Settings) -> Iterator[Row]:
    """Lists numbers of Gaussians, responses, orders and projections."""
    for name in settings.sets or (HALL,):
        for count in settings.counts:
            for response in settings.responses:
                rows = [(order, EXACT) for order in ORDERS]
                rows += [("distance", each) for each in FOOTPRINTS if response == "maximum"]
                for order, projection in rows:
                    yield {
                        "data": name, "count": f"{count:,}", "response": response, "order": order,
                        "projection": projection, "_count": count,
                    }  # fmt: skip


def measure(case: Row, settings: Settings) -> Row:
    """Trains, unless it was done, and compares one order with the integral of the same model."""
    count, response, order = case["_count"], case["response"], case["order"]
    data = settings.path(case["data"])
    # No training draws the density: it is of the maximum's model, drawn otherwise.
    trained = "maximum" if response == "density" else response
    run = settings.folder / f"{data.name}-{count}-{trained}"
    flags = shlex.split(f"{settings.flags} --max-gaussians {count}")
    _train(data, run, flags, trained)
    model = dataclasses.replace(gsut.load_gaussians(run / "scene.ply"), response=response)
    scene = gsut.load_dataset(data)
    plain = _take_plain_colors(model)
    judged = _Judged()
    if settings.film and _is_filmed(case, settings):
        _, camera, pose = _choose_views(scene, 1)[0]
        film = Path(settings.film)
        film_orders(film, model, plain, camera, pose, ORDERS[:-1], settings.frames)
    for number, (view, camera, pose) in enumerate(_choose_views(scene, settings.views)):
        pixels = _sample_patches(camera, settings.patches, number)
        seen = pixels[: settings.integrals, :1]
        lines = find_lines(camera, pose, seen)
        truth = _integrate(run / f"{response}-{number}.npz", plain, camera, pose, seen)
        if case["projection"] != EXACT:
            drawn = _draw_footprints(plain, camera, pose, seen[:, 0], case["projection"])
            judged.off.append(drawn[:, None] - truth[0])
            continue
        drawn = truth if order == "integral" else draw_lines(plain, lines, pose, order)
        judged.off.append(drawn[0] - truth[0])
        at = tuple(seen[:, 0].T)
        name = Path(scene.views[view].name).stem
        true = read_depth(scene, view, data / "depth" / f"{name}.png")
        if true is not None:
            depths = {"mean": drawn[2][:, 0] / drawn[1][:, 0]}
            if order == "distance" and response != "density":
                image = gsut.render(plain.to_dtype(np.float32), camera, pose)
                for kind in ("median", "strongest"):
                    depths[kind] = measure_depth(image, kind)[at]
            judged.add_depths(depths, true[at])
        if order != "integral":
            _add_swaps(judged, plain, camera, pose, pixels, order)
    is_float = response != "density" and order != "integral" and case["projection"] == EXACT
    row = judged.summarize(is_reference=order == "integral")
    if is_float:
        own = run.with_name(f"{run.name}-{order}") if order != model.order else run
        row["train_seconds"] = _train(data, own, [*flags, "--order", order], trained)
        row["trained_psnr"] = _measure_psnr(gsut.load_gaussians(own / "scene.ply"), scene, order)
        row["psnr"] = _measure_psnr(model, scene, order)
        row |= _time_passes(model, scene, order)
    return row


def _train(data: Path, out: Path, flags: Sequence[str], response: str) -> float:
    """Trains with flags of `gsut train` and a response, unless it was done; returns CPU seconds."""
    took = out.with_name(f"{out.name}.took.json")
    if not took.is_file():
        words = build_parser(["train"]).parse_args(["train", str(data), "-o", str(out), *flags])
        options = TrainOptions(**collect_given(TrainOptions, words), response=response)
        began = time.process_time()
        gsut.train(gsut.load_dataset(data), options, out=out, progress=False)
        took.write_text(json.dumps(time.process_time() - began))
    return json.loads(took.read_text())


def _is_filmed(case: Row, settings: Settings) -> bool:
    """Returns whether the film is of this row's model: one row has it made for all orders."""
    first = (settings.counts[0], settings.responses[0])
    return case["order"] == "ray" and (case["_count"], case["response"]) == first


@dataclasses.dataclass
class _Judged:
    """What was measured of a row, view by view."""

    off: list[np.ndarray] = dataclasses.field(default_factory=list)
    swaps: dict[str, list[np.ndarray]] = dataclasses.field(default_factory=dict)
    depths: dict[str, list[np.ndarray]] = dataclasses.field(default_factory=dict)

    def add_depths(self, depths: dict[str, np.ndarray], true: np.ndarray) -> None:
        for kind, values in depths.items():
            self.depths.setdefault(kind, []).append(100 * (values / true - 1)[true > 0])

    def summarize(self, is_reference: bool) -> Row:
        """Summarizes errors, which the integral has none of, the largest swaps, and depths."""
        row: Row = {}
        errors = np.concatenate(self.off)
        if not is_reference:
            row["error_db"] = -10 * np.log10(np.mean(errors**2))
            row["error_rare"] = float(np.quantile(np.abs(errors), 0.999))
        for motion, values in self.swaps.items():
            row[motion] = float(np.abs(np.concatenate(values)).max())
        for kind, values in self.depths.items():
            percent = np.concatenate(values)
            row[f"{kind}_bias"] = float(np.nanmedian(percent))
            row[f"{kind}_off"] = float(np.nanmedian(np.abs(percent)))
        return row


def _add_swaps(
    judged: _Judged,
    plain: Gaussians,
    camera: gsut.Camera,
    pose: np.ndarray,
    pixels: np.ndarray,
    order: str,
) -> None:
    """Adds what jumps in patches of pixels when the camera moves by a frame."""
    for motion, moved in move_camera(pose).items():
        there = find_lines(camera, moved, pixels)
        jump = draw_lines(plain, there, moved, order)[0] - draw_lines(plain, there, pose, order)[0]
        judged.swaps.setdefault(motion, []).append(jump.mean(axis=1))


def _draw_footprints(
    g: Gaussians, camera: gsut.Camera, pose: np.ndarray, pixels: np.ndarray, method: str
) -> np.ndarray:
    """Draws pixels (P, 2) by footprints, normal distributions in the picture, by distance."""
    rule = gsut.BlendRule()
    found = gsut.project(g, camera, pose, method=method, dtype="float64")
    rows = np.flatnonzero(found.valid)
    rows = rows[np.argsort(found.depths[rows], kind="stable")]
    inverse = np.linalg.pinv(found.covariances[rows], hermitian=True)
    opacity = 1 / (1 + np.exp(-g.opacity_logits[rows]))
    colors = np.maximum(g.sh[rows, 0] / np.sqrt(4 * np.pi) + 0.5, 0.0)
    drawn = []
    for v, u in pixels + 0.5:
        off = np.array([u, v]) - found.centers[rows]
        squares = np.einsum("ni,nij,nj->n", off, inverse, off)
        alpha = np.minimum(opacity * np.exp(-0.5 * squares), rule.alpha_max)
        alpha[alpha < rule.alpha_min] = 0.0
        front = np.concatenate([[1.0], np.cumprod(1 - alpha)[:-1]])
        front[front < rule.transmittance_min] = 0.0
        drawn.append((front * alpha) @ colors)
    return np.array(drawn)


def _choose_views(scene: gsut.Scene, most: int) -> Views:
    """Chooses held-out views, evenly."""
    rows = np.unique(np.linspace(0, len(scene.test_indices) - 1, most).astype(int))
    chosen = [scene.test_indices[row] for row in rows]
    return [(i, scene.camera(i), scene.views[i].camera_from_world) for i in chosen]


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


def _integrate(
    file: Path, g: Gaussians, camera: gsut.Camera, pose: np.ndarray, pixels: np.ndarray
) -> tuple[np.ndarray, ...]:
    """Integrates along the rays of patches, unless it was done: it takes longer than all else."""
    if not file.is_file():
        parts = []
        for patch in pixels:
            rows = _find_seen(g, camera, pose, patch)
            lines = find_lines(camera, pose, patch[None])
            parts.append(draw_lines(g[rows], lines, pose, "integral"))
        np.savez(file, *(np.concatenate(part) for part in zip(*parts, strict=True)))
    with np.load(file) as kept:
        return tuple(kept.values())


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


def _time_passes(model: Gaussians, scene: gsut.Scene, order: str) -> dict[str, float]:
    """Measures milliseconds, of all threads together, of a held-out view: stages and a frame."""
    renderer, rule = _core.Renderer(), _make_rule(order)
    g = model.with_origin((0.0, 0.0, 0.0))
    gradients, touched = g.make_zeros(), np.zeros(len(g), np.uint8)
    least = []
    for i in scene.test_indices:
        camera, pose = scene.camera(i), scene.views[i].camera_from_world
        image = np.zeros((camera.height, camera.width, 3), np.float32)
        job = _core.RenderJob(camera, pose, rule=rule, sh_degree=g.sh_degree)
        took = []
        for _ in range(_TIMED):
            renderer.render(g, job, image)
            drawn = {name: times[1] for name, times in renderer.timings().items()}
            renderer.backward(image, gradients, touched)
            took.append((drawn["forward"], sum(drawn.values()), renderer.timings()["backward"][1]))
        least.append(np.min(took, axis=0))
    blend, frame, backward = (1e3 * np.mean(least, axis=0)).tolist()
    return {"blend_ms": blend, "frame_ms": frame, "backward_ms": backward}


BENCHMARK = Benchmark(
    help="error of orders, responses and projections against the integral of the same Gaussians",
    columns=(
        Column("data"),
        Column("count", "Gaussians"),
        Column("response"),
        Column("order"),
        Column("projection"),
        Column("trained_psnr", "held-out PSNR, trained by it", "dB", ".2f"),
        Column("psnr", "trained by the distance", "dB", ".2f"),
        Column("error_db", "against the integral", "dB", ".1f"),
        Column("error_rare", "1 of 1000 values off by", form=".3f"),
        Column("turn", "largest swap of a turn", form=".3f"),
        Column("step", "of a step", form=".3f"),
        Column("blend_ms", "blend", "CPU-ms", ".1f"),
        Column("frame_ms", "frame", "CPU-ms", ".1f"),
        Column("backward_ms", "backward", "CPU-ms", ".1f"),
        Column("train_seconds", "training", "CPU-s", ".1f"),
        Column("mean_bias", "mean depth too far by", "%", ".2f"),
        Column("mean_off", "mean depth off by", "%", ".2f"),
        Column("median_bias", "median depth too far by", "%", ".2f"),
        Column("median_off", "median depth off by", "%", ".2f"),
        Column("strongest_bias", "strongest too far by", "%", ".2f"),
        Column("strongest_off", "strongest off by", "%", ".2f"),
    ),
    cases=list_cases,
    measure=measure,
    options=(
        Option("counts", (20_000, 50_000), "numbers of Gaussians"),
        Option("responses", ("maximum", "extinction", "density"), "of the model"),
        Option("flags", "--preset fast", "of gsut train"),
        Option("views", 3, "held-out views of errors and swaps"),
        Option("patches", 96, "of 4 x 4 pixels a view, whose swaps are measured"),
        Option("film", "", "file (.mp4, .webm, .gif): the first model in all orders side by side"),
        Option("frames", 20, "of the film's turn, and of its steps"),
        Option("integrals", 24, "of them, one pixel each, whose errors are measured"),
    ),
)
