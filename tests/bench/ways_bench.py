"""`./run bench ways`: a frame by native code and by WebAssembly, with its errors."""

from __future__ import annotations

import dataclasses
import functools
import json
import math
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from gsut import _core
from gsut.lens import Camera
from lab.demo_tracer.views import make_camera
from tests.bench.accuracy import Truth, count_missed, errors_of, make_truth
from tests.bench.harness import WRONG, Benchmark, Column, Option, Row, Settings
from tests.bench.render_bench import IMAGE_RMS_BOUND
from tests.bench.scenes import BenchScene, parsed_count, synthetic_scene

NATIVE, WASM = "native", "WebAssembly"
_PLAIN_DEGREES = 80.0  # field of view of the pinhole
_WIDE_DEGREES = 220.0
# Relative error of an alpha in float: of needles far thinner than a pixel it reaches 1e-3.
_JUMP = 2e-3
_MOST_SECONDS = 8.0  # of the frames of a row, beside the first
# Image, alpha, and milliseconds of a frame by the clock and of the processor, all threads together.
Drawn = tuple[np.ndarray, np.ndarray, tuple[float, float]]


def make_lens(name: str, pixels: int) -> Camera:
    """Makes one of the lenses, for images of about so many pixels."""
    side = round(math.sqrt(pixels))
    if name == "pinhole":
        width, height = round(side * 2 / math.sqrt(3)), round(side * math.sqrt(3) / 2)
        focal = width / 2 / math.tan(math.radians(_PLAIN_DEGREES / 2))
        return Camera("pinhole", [focal, focal, width / 2, height / 2], width, height)
    if name == "demo's fisheye":
        return make_camera(side)
    if name == "220 degrees":
        half = math.radians(_WIDE_DEGREES / 2)
        focal = side / 2 / half
        params = [focal, focal, side / 2, side / 2, 0.0, 0.0, 0.0, 0.0]
        return Camera("kannala_brandt", params, side, side, valid_field_angle=half)
    _, params, *size = _core.camera_examples("splined_stereographic")[0]
    scale = math.sqrt(pixels / (size[0] * size[1]))
    return Camera("splined_stereographic", params, *size).resize(*(round(scale * x) for x in size))


LENSES = ("pinhole", "demo's fisheye", "220 degrees", "splined")


def list_cases(settings: Settings) -> Iterator[Row]:
    """Lists lenses, numbers of Gaussians and the ways that this machine has."""
    ways = {NATIVE: f"{NATIVE}, {_core.active_isa()}, {_core.num_threads()} threads"}
    if shutil.which("node"):
        ways[WASM] = f"{WASM}, 1 thread"
    for count in settings.counts:
        for lens in LENSES:
            for way, text in ways.items():
                yield {"lens": lens, "count": count, "way": text, "_way": way}


def measure(case: Row, settings: Settings) -> Row:
    """Draws one scene one way."""
    scene, truth = _prepare(case["lens"], case["count"], settings.tiles, settings.pixels)
    draw = {NATIVE: _draw_natively, WASM: _draw_in_node}[case["_way"]]
    image, alpha, (milliseconds, cpu_milliseconds) = draw(scene, settings.runs)
    errors = errors_of(truth, image, None)
    missed = count_missed(truth, alpha, _core.BlendRule().alpha_min)
    row = {
        "ms": milliseconds, "cpu_ms": cpu_milliseconds, "image_rms_error": errors.image_rms,
        "missed": missed, "pairs_per_pixel": truth.pairs_per_pixel,
    }  # fmt: skip
    if errors.image_rms > IMAGE_RMS_BOUND or missed:
        row[WRONG] = "no time: the errors are out of bounds"
    return row


@functools.lru_cache(maxsize=1)
def _prepare(lens: str, count: str, tiles: int, pixels: int) -> tuple[BenchScene, Truth]:
    room = synthetic_scene(parsed_count(count), 640, 480, sigma_pixels=_choose_sigma(count))
    scene = dataclasses.replace(room, camera=make_lens(lens, pixels))
    return scene, make_truth(
        scene, _core.BlendRule(), tiles=tiles, with_gradients=False, jump=_JUMP
    )


def _choose_sigma(count: str) -> float:
    """Chooses the Gaussians' size so that as many are blended a pixel as at 100,000."""
    return 1.9 * math.sqrt(100_000 / parsed_count(count))


def _draw_natively(scene: BenchScene, runs: int) -> Drawn:
    shape = (scene.camera.height, scene.camera.width)
    image, alpha = np.zeros((*shape, 3), np.float32), np.zeros(shape, np.float32)
    renderer = _core.Renderer()
    job = _core.RenderJob(scene.camera, np.asarray(scene.camera_from_world), keep=False)
    took = _time_frames(lambda: renderer.render(scene.gaussians, job, image, alpha), runs)
    return image, alpha, took


def _draw_in_node(scene: BenchScene, runs: int) -> Drawn:
    sys.path.append(str(Path(__file__).parents[1] / "python"))
    import core_in_node

    with tempfile.TemporaryDirectory(prefix="gsut-ways-") as folder:
        place = np.asarray(scene.camera_from_world)
        job = (scene.gaussians, scene.camera, place, place, "global", runs)
        drawn = core_in_node.draw_in_node(Path(folder), [job])[0]
        took = json.loads((Path(folder) / "times.json").read_text(encoding="utf-8"))[0]
    behind = np.float32(core_in_node.BACKGROUND)
    image = drawn[..., :3] - (1.0 - drawn[..., 3:4]) * behind * scene.camera.rays()[1][..., None]
    return image, drawn[..., 3], took


def _time_frames(draw: Callable[[], object], runs: int) -> tuple[float, float]:
    """Draws a frame, then some more; returns the least milliseconds of these, see `Drawn`."""
    draw()
    end, wall, cpu = time.perf_counter() + _MOST_SECONDS, math.inf, math.inf
    for _ in range(runs):
        began, used = time.perf_counter(), time.process_time()
        draw()
        wall = min(wall, 1e3 * (time.perf_counter() - began))
        cpu = min(cpu, 1e3 * (time.process_time() - used))
        if time.perf_counter() > end:
            break
    return wall, cpu


BENCHMARK = Benchmark(
    help="a frame by native code and by WebAssembly, with its errors",
    columns=(
        Column("lens"),
        Column("count", "Gaussians"),
        Column("way"),
        Column("pairs_per_pixel", "blended per pixel", form=".0f"),
        Column("ms", "a frame", "ms", ".0f"),
        Column("cpu_ms", "all threads", "CPU-ms", ".0f"),
        Column("image_rms_error", "image rms error", form=".1e"),
        Column("missed", "missed pairs", form="d"),
    ),
    cases=list_cases,
    measure=measure,
    options=(
        Option("counts", ("100k", "1m"), "Gaussians"),
        Option("pixels", 640 * 480, "of each image, whatever its shape"),
        Option("runs", 3, "frames, of which the fastest counts"),
        Option("tiles", 12, "random tiles whose errors are measured"),
    ),
)
