"""`./run bench light`: light and blur in photographs, found against truth, and their worth."""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

import gsut
from gsut.evaluate import evaluate
from gsut.render import Falloff, Light, compute_field_angles
from lab.demo_tracer import make_demo_scene
from lab.demo_tracer.dataset import render_views
from lab.demo_tracer.hall import make_hall
from lab.demo_tracer.texture import to_linear, to_srgb
from lab.demo_tracer.views import plan_walk
from tests.bench.harness import HALL, Benchmark, Column, Option, Row, Settings

_EXPOSURE = 0.07  # standard deviation of log-gains, as of a phone's photographs
_BALANCE = 0.02  # the same of each channel
_CORRELATION = 4.0  # views over which exposure stays alike
_FALLOFF = (-0.25, -0.1, 0.0)  # of t^2, t^4, t^6: 65 % at the rim
_BLURRED = 4  # one of this many photographs is moved
_BLUR_PX = (5.0, 11.0)  # how far
_EXPOSED = 0.1  # of the time from one photograph to the next, while the camera walks on
_RAYS = 2  # per pixel's side
_PLACES_PER_PX = 1.5  # of the camera during the exposure, for each pixel that it moves by
_PLACES = (4, 30)  # at least and at most
_FINE = 200  # places on the path from one photograph to the next
_NOISE = 1.0  # grey levels, standard deviation
# Light -> what disturbs the photographs, and the flag that helps besides --exposure.
LIGHTS: dict[str, tuple[tuple[str, ...], str]] = {
    "none": ((), ""),
    "exposure": (("gain",), ""),
    "falloff": (("falloff",), ""),
    "exposure + falloff + noise": (("gain", "falloff", "noise"), ""),
    "two passers-by": (("people",), "--robust"),
    "blur + noise": (("blur", "noise"), ""),
    "motion + noise": (("motion", "noise"), ""),
}


def list_cases(settings: Settings) -> Iterator[Row]:
    """Lists the hall's lights, and datasets in their own, without and with what helps."""
    for data in settings.sets or (HALL, "fox", "gopro_max_walk"):
        for light in settings.lights if data == HALL else ("its own",):
            flag = LIGHTS[light][1] if data == HALL else ""
            for way in ("--exposure off", flag or "--exposure auto"):
                yield {"data": data, "light": light, "flags": way}


def measure(case: Row, settings: Settings) -> Row:
    """Trains in the light; the hall's is compared with the truth."""
    if case["data"] != HALL:
        return _train(case, settings, settings.path(case["data"]))[0]
    clean = settings.make(
        f"hall-{settings.size}",
        lambda path: make_demo_scene(path, settings.views, 6, settings.size, progress=False),
    )
    parts = LIGHTS[case["light"]][0]
    name = "lit " + case["light"]
    data = settings.make(name, lambda path: disturb_light(clean, path, parts, seed=1))
    truth = draw_light(gsut.load_dataset(clean), parts, np.random.default_rng(1))
    row, result = _train(case, settings, data)
    undisturbed, light = gsut.load_dataset(clean), result.metrics.get("light")
    row["psnr_truth"] = evaluate(
        result.gaussians, undisturbed, undisturbed.test_indices,
        light=None if light is None else _keep_level(light, undisturbed),
    )["psnr"]  # fmt: skip
    return row if light is None else row | compare_light(light, truth, gsut.load_dataset(data))


def _keep_level(found: Row, scene: gsut.Scene) -> Light:
    """Returns the factor common to all photographs, by which the truth is brighter in the middle
    than the scene: the falloff's mean is 1 there, its centre here."""
    gains = Light.from_dict(found, [view.name for view in scene.views]).gains
    level = np.exp(np.log(gains[list(scene.train_indices)]).mean(axis=0))
    return Light(np.tile(level, (len(scene.views), 1)), (None,))


def _train(case: Row, settings: Settings, data: Path) -> tuple[Row, gsut.TrainResult]:
    flags = case["flags"]
    options = gsut.TrainOptions(
        steps=settings.steps, max_gaussians=settings.max_gaussians,
        scale=1.0 if case["data"] == HALL else settings.scale,
        exposure="auto" if "auto" in flags else "off", robust="--robust" in flags,
    )  # fmt: skip
    began = time.process_time()
    result = gsut.train(gsut.load_dataset(data), options, progress=False)
    row = {"cpu_seconds": time.process_time() - began}
    names = ("psnr", "psnr_unit_gain", "psnr_color_corrected")
    return row | {name: result.metrics[name] for name in names}, result


def compare_light(found: Row, truth: Light, scene: gsut.Scene) -> Row:
    """Returns how far gains and falloff are off, in percent; a common factor is free."""
    light = Light.from_dict(found, [view.name for view in scene.views])
    train = list(scene.train_indices)
    off = np.log(light.gains[train] / truth.gains[train])
    angles = np.linspace(0, float(np.nanmax(compute_field_angles(scene.cameras[0]))), 50)
    shapes = [
        np.ones((50, 3)) if each is None else each.evaluate(angles)
        for each in (light.falloffs[0], truth.falloffs[0])
    ]
    apart = np.log(shapes[0] / shapes[1])
    return {
        "gain_percent": 100 * float(np.sqrt(np.mean((off - off.mean(axis=0)) ** 2))),
        "falloff_percent": 100 * float(np.abs(apart - apart.mean(axis=0)).max()),
    }


def draw_light(scene: gsut.Scene, parts: tuple[str, ...], rng: np.random.Generator) -> Light:
    """Draws gains that drift over the views, and a falloff."""
    order = _sort_views(scene)
    gains = {view.name: np.ones(3) for view in order}
    if "gain" in parts:
        drift = _draw_drift(rng, len(order), 1, _EXPOSURE)
        drift = drift + _draw_drift(rng, len(order), 3, _BALANCE)
        gains = {view.name: np.exp(row) for view, row in zip(order, drift, strict=True)}
    angle = float(np.nanmax(compute_field_angles(scene.cameras[0])))
    falloff = Falloff(angle, np.tile(_FALLOFF, (3, 1))) if "falloff" in parts else None
    return Light(np.array([gains[view.name] for view in scene.views]), (falloff,))


def _sort_views(scene: gsut.Scene) -> list[gsut.View]:
    return sorted(scene.views, key=lambda view: view.name.split("_")[-1])


def disturb_light(clean: Path, data: Path, parts: tuple[str, ...], seed: int) -> None:
    """Copies a dataset, its photographs taken in another light.

    Args:
        clean: the dataset.
        data: the copy.
        parts: of "gain" (drifts smoothly over the views), "falloff", "noise", "people" (two in
            each training photograph, nowhere twice), "blur" (of some training photographs) and
            "motion" (of the camera along the demo's path, in all training photographs).
        seed: of all that is random.
    """
    shutil.copytree(clean, data)
    scene = gsut.load_dataset(clean)
    rng = np.random.default_rng(seed)
    light = draw_light(scene, parts, rng)
    train = sorted(scene.train_indices, key=lambda row: scene.views[row].name.split("_")[-1])
    moved = rng.choice(train, len(train) // _BLURRED, replace=False) if "blur" in parts else []
    for index, view in enumerate(scene.views):
        seen = scene.image(index)
        if "motion" in parts and index in scene.train_indices:
            seen = _trace_motion(scene, index)
        lit = seen * light.on(scene.cameras[0], index, 0)
        if "people" in parts and index in scene.train_indices:
            lit = _draw_people(lit.astype(np.uint8), rng)
        if index in moved:
            lit = _blur_by_motion(lit.astype(np.float32), rng)
        if "noise" in parts:
            lit = lit + rng.normal(0, _NOISE, lit.shape)
        pixels = np.clip(np.rint(lit), 0, 255).astype(np.uint8)
        cv2.imwrite(str(data / view.name), pixels[..., ::-1])


def _trace_motion(scene: gsut.Scene, index: int) -> np.ndarray:
    """Traces the mean of light over the exposure on the demo's path: (H, W, 3) in grey levels."""
    name, camera = scene.views[index].name, scene.cameras[0]
    place, count = int(name.split("_")[-1].split(".")[0]), _FINE * len(scene.views)
    path = plan_walk(count, 0)
    half = round(_EXPOSED * _FINE / 2)
    ways = np.arange(-half, half + 1) + _FINE * place
    ends = [np.linalg.inv(path[way % count]) for way in (ways[0], ways[-1])]
    rays, valid = camera.rays()
    far = scene.extent * rays[valid].astype(np.float64)
    turned = far @ (ends[1] @ np.linalg.inv(ends[0]))[:3, :3].T
    apart = np.linalg.norm(camera.project(turned)[0] - camera.project(far)[0], axis=1)
    number = int(np.clip(_PLACES_PER_PX * np.nanmedian(apart), *_PLACES))
    chosen = np.linspace(0, len(ways) - 1, 2 * number + 1).round().astype(int)[1::2]
    poses = [path[way % count] for way in ways[chosen]]
    shown = render_views(make_hall(0), camera, poses, False, _RAYS)
    light = np.mean([to_linear(picture / 255.0) for picture in shown], axis=0)
    return 255.0 * to_srgb(light)


def _blur_by_motion(picture: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Averages (H, W, 3) float32 over a straight motion in some direction."""
    angle, length = rng.uniform(0, np.pi), rng.uniform(*_BLUR_PX)
    size, total = picture.shape[1::-1], np.zeros_like(picture)
    ways = np.linspace(-length / 2, length / 2, 2 * (int(length) | 1))
    for way in ways:
        shift = np.array([[1, 0, way * np.cos(angle)], [0, 1, way * np.sin(angle)]], np.float32)
        total += cv2.warpAffine(picture, shift, size, borderMode=cv2.BORDER_REPLICATE)
    return total / len(ways)


def _draw_people(picture: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Draws two figures, of a body and a head each, somewhere on (H, W, 3) uint8."""
    picture = np.ascontiguousarray(picture)
    size = np.array(picture.shape[1::-1])
    for _ in range(2):
        middle = (rng.uniform([0.25, 0.3], [0.75, 0.7]) * size).astype(int)
        body = (rng.uniform([0.05, 0.12], [0.09, 0.2]) * size).astype(int)
        head = (int(middle[0]), int(middle[1] - body[1]))
        for center, axes in ((middle.tolist(), body.tolist()), (head, [int(body[0] // 2) + 1] * 2)):
            color = rng.integers(20, 235, 3).tolist()
            cv2.ellipse(picture, center, axes, 0.0, 0.0, 360.0, color, -1)
    return picture


def _draw_drift(
    rng: np.random.Generator, count: int, channels: int, deviation: float
) -> np.ndarray:
    """Draws (count, channels) noise of this deviation that stays alike over some rows."""
    width = np.arange(count)[:, None] - np.arange(count)[None]
    window = np.exp(-0.5 * (width / _CORRELATION) ** 2)
    out = window @ rng.normal(size=(count, channels))
    out -= out.mean(axis=0)
    return out * deviation / out.std(axis=0)


BENCHMARK = Benchmark(
    help="exposure, white balance, falloff, blur, passers-by: found against truth, and their worth",
    columns=(
        Column("data"),
        Column("light"),
        Column("flags"),
        Column("psnr", "predicted gain", "dB", ".2f"),
        Column("psnr_unit_gain", "gain 1", "dB", ".2f"),
        Column("psnr_color_corrected", "colour-corrected", "dB", ".2f"),
        Column("psnr_truth", "undisturbed truth", "dB", ".2f"),
        Column("gain_percent", "gains off", "%", ".2f"),
        Column("falloff_percent", "falloff off", "%", ".2f"),
        Column("cpu_seconds", "training", "CPU-s", ".0f"),
    ),
    cases=list_cases,
    measure=measure,
    options=(
        Option("lights", tuple(LIGHTS), "of the hall"),
        Option("steps", 400, "of each training"),
        Option("max_gaussians", 30_000, "of each training"),
        Option("scale", 0.25, "of the images of datasets"),
        Option("views", 40, "of the hall"),
        Option("size", 200, "of the hall's images, pixels"),
    ),
)
