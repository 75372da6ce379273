"""`./run bench light`: what the photograph model finds of known light, and what it is worth."""

from __future__ import annotations

import argparse
import dataclasses
import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np

import gsut
from gsut.demo import make_demo_scene
from gsut.demo.dataset import render_views
from gsut.demo.hall import make_hall
from gsut.demo.texture import to_linear, to_srgb
from gsut.demo.views import camera_path
from gsut.evaluate import evaluate
from gsut.render import Falloff, Light, field_angles
from gsut.training import TrainingLoop, prepare_scene
from gsut.training.first.gains import find_first_gains
from tests.bench.report_rows import add_files, check_files, print_and_write

_EXPOSURE, _BALANCE = 0.07, 0.02  # standard deviations of log-gains, as measured on fox
_CORRELATION = 4.0  # views over which exposure stays alike
_FALLOFF = (-0.25, -0.1, 0.0)  # of t^2, t^4, t^6: 65 % at the rim
_BLURRED, _BLUR = 4, (5.0, 11.0)  # one of so many photographs is moved by so many pixels
# The camera walks on while photographs are exposed: for so long, of the time from one to the next;
# so many rays a pixel's side, from so many places for each pixel that it moves by.
_EXPOSED, _RAYS, _PLACES = 0.1, 2, (1.5, 4, 30)
_FINE = 200  # places on the path from one photograph to the next
# What helps.
_FLAGS = {
    "people": "--robust",
    "blur": "--drop-blurred",
    "motion": f"--motion-blur {_EXPOSED:g}",
}
_NOISE = 1.0  # grey levels, standard deviation
COLUMNS = (
    ("light in the photographs", "disturbed", ""),
    ("--exposure", "exposure", ""),
    ("PSNR, predicted gain [dB]", "psnr", ".2f"),
    ("gain 1", "psnr_unit_gain", ".2f"),
    ("colour-corrected", "psnr_color_corrected", ".2f"),
    ("half image", "psnr_half_image", ".2f"),
    ("against undisturbed truth", "psnr_truth", ".2f"),
    ("gains off by [%]", "gain_percent", ".2f"),
    ("falloff off by [%]", "falloff_percent", ".2f"),
    ("CPU-s", "cpu_seconds", ".0f"),
    ("of it the model [%]", "model_percent", ".1f"),
)


@dataclasses.dataclass(frozen=True)
class LightBenchOptions:
    """What is measured.

    Args:
        data: datasets that are trained as they are, with and without the model; none: the demo's
            hall, under light that is known.
        steps, max_gaussians, scale: of each training.
        views, size: of the hall.
    """

    data: tuple[Path, ...] = ()
    steps: int = 800
    max_gaussians: int = 30_000
    scale: float = 1.0
    views: int = 40
    size: int = 200


HELP = "exposure, white balance and falloff: found against truth, and what they are worth"


def add_flags(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--data",
        type=Path,
        nargs="+",
        default=(),
        metavar="DATA",
        help="datasets as they are [default: the demo's hall in known light]",
    )
    for name, text in (
        ("steps", "training steps"),
        ("max_gaussians", "of each training"),
        ("views", "of the hall"),
        ("size", "of its images, pixels"),
    ):
        default = getattr(LightBenchOptions, name)
        flag = "--" + name.replace("_", "-")
        parser.add_argument(flag, type=int, default=default, help=f"{text} [{default}]")
    parser.add_argument("--scale", type=float, default=1.0, help="of the data's images [1]")
    add_files(parser)


def run(arguments: argparse.Namespace) -> int:
    check_files(arguments)
    names = [field.name for field in dataclasses.fields(LightBenchOptions)]
    options = LightBenchOptions(**{name: getattr(arguments, name) for name in names})
    rows = run_light(options, lambda text: print(text, file=sys.stderr))
    print_and_write(rows, COLUMNS, arguments)
    return 0


def run_light(options: LightBenchOptions, say: Callable[[str], None]) -> list[dict[str, Any]]:
    """One row for each way to train on each light."""
    rows = []
    for data in options.data:
        for exposure in ("off", "auto"):
            say(f"{data.name}, --exposure {exposure}")
            rows.append(_train(options, data, exposure) | {"disturbed": f"{data.name}, as it is"})
    if rows:
        return rows
    with tempfile.TemporaryDirectory(prefix="gsut-light-") as folder:
        clean = make_demo_scene(
            Path(folder) / "clean", options.views, 6, options.size, progress=False
        )
        for name, parts in (
            ("none", ()),
            ("exposure", ("gain",)),
            ("falloff", ("falloff",)),
            ("exposure, falloff, noise", ("gain", "falloff", "noise")),
            ("two passers-by", ("people",)),
            ("blur, noise", ("blur", "noise")),
            ("camera moves, noise", ("motion", "noise")),
        ):
            data = Path(folder) / name.replace(", ", "_")
            truth = disturb(clean, data, parts, seed=1)
            ways = next(
                (("off", f"off, {flag}") for part, flag in _FLAGS.items() if part in parts),
                ("off", "auto"),
            )
            for exposure in ways:
                say(f"{name}, --exposure {exposure}")
                row = _train(options, data, exposure, clean=clean, truth=truth)
                rows.append(row | {"disturbed": name})
    return rows


def disturb(clean: Path, data: Path, parts: tuple[str, ...], seed: int) -> Light:
    """Copies a dataset, its photographs taken in another light.

    Args:
        clean: the dataset.
        data: the copy.
        parts: of "gain" (drifts smoothly over the views), "falloff", "noise", "people" (two in
            each training photograph, nowhere twice), "blur" (of some training photographs) and
            "motion" (of the camera along the demo's path, in all training photographs).
        seed: of all that is random.

    Returns:
        The light.
    """
    shutil.copytree(clean, data)
    scene = gsut.load_dataset(clean)
    rng = np.random.default_rng(seed)
    order = sorted(scene.views, key=lambda view: view.name.split("_")[-1])
    gains = {view.name: np.ones(3) for view in order}
    if "gain" in parts:
        drift = _smooth(rng, len(order), 1, _EXPOSURE) + _smooth(rng, len(order), 3, _BALANCE)
        gains = {view.name: np.exp(row) for view, row in zip(order, drift, strict=True)}
    angle = float(np.nanmax(field_angles(scene.cameras[0])))
    falloff = Falloff(angle, np.tile(_FALLOFF, (3, 1))) if "falloff" in parts else None
    light = Light(np.array([gains[view.name] for view in scene.views]), (falloff,))
    train = sorted(scene.train_indices, key=lambda row: scene.views[row].name.split("_")[-1])
    moved = rng.choice(train, len(train) // _BLURRED, replace=False) if "blur" in parts else []
    for index, view in enumerate(scene.views):
        seen = scene.image(index)
        if "motion" in parts and index in scene.train_indices:
            seen = _seen_in_motion(scene, index)
        lit = seen * light.on(scene.cameras[0], index, 0)
        if "people" in parts and index in scene.train_indices:
            lit = _with_people(lit.astype(np.uint8), rng)
        if index in moved:
            lit = _moved(lit.astype(np.float32), rng)
        if "noise" in parts:
            lit = lit + rng.normal(0, _NOISE, lit.shape)
        pixels = np.clip(np.rint(lit), 0, 255).astype(np.uint8)
        cv2.imwrite(str(data / view.name), pixels[..., ::-1])
    return light


def _first_look(scene: gsut.Scene, settings: gsut.TrainOptions) -> float:
    """Processor seconds in which the scene's points are asked for gains."""
    small = prepare_scene(scene.centred, settings.resolved())
    small.check_pixels()
    started = time.process_time()
    find_first_gains(small)
    return time.process_time() - started


def _seen_in_motion(scene: gsut.Scene, index: int) -> np.ndarray:
    """(H, W, 3) in grey levels: the mean of light over the exposure on the demo's path."""
    name, camera = scene.views[index].name, scene.cameras[0]
    place, count = int(name.split("_")[-1].split(".")[0]), _FINE * len(scene.views)
    path = camera_path(count, 0)
    half = round(_EXPOSED * _FINE / 2)
    ways = np.arange(-half, half + 1) + _FINE * place
    ends = [np.linalg.inv(path[way % count]) for way in (ways[0], ways[-1])]
    rays, valid = camera.rays()
    far = scene.extent * rays[valid].astype(np.float64)
    turned = far @ (ends[1] @ np.linalg.inv(ends[0]))[:3, :3].T
    apart = np.linalg.norm(camera.project(turned)[0] - camera.project(far)[0], axis=1)
    per_pixel, least, most = _PLACES
    number = int(np.clip(per_pixel * np.nanmedian(apart), least, most))
    chosen = np.linspace(0, len(ways) - 1, 2 * number + 1).round().astype(int)[1::2]
    poses = [path[way % count] for way in ways[chosen]]
    shown = render_views(make_hall(0), camera, poses, False, _RAYS)
    light = np.mean([to_linear(picture / 255.0) for picture in shown], axis=0)
    return 255.0 * to_srgb(light)


def _moved(picture: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(H, W, 3) float32, the mean over a straight motion in some direction."""
    angle, length = rng.uniform(0, np.pi), rng.uniform(*_BLUR)
    size, total = picture.shape[1::-1], np.zeros_like(picture)
    ways = np.linspace(-length / 2, length / 2, 2 * (int(length) | 1))
    for way in ways:
        shift = np.array([[1, 0, way * np.cos(angle)], [0, 1, way * np.sin(angle)]], np.float32)
        total += cv2.warpAffine(picture, shift, size, borderMode=cv2.BORDER_REPLICATE)
    return total / len(ways)


def _with_people(picture: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(H, W, 3) uint8 with two figures somewhere, of a body and a head each."""
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


def _smooth(rng: np.random.Generator, count: int, channels: int, deviation: float) -> np.ndarray:
    """(count, channels) noise that stays alike over some rows, with this standard deviation."""
    width = np.arange(count)[:, None] - np.arange(count)[None]
    window = np.exp(-0.5 * (width / _CORRELATION) ** 2)
    out = window @ rng.normal(size=(count, channels))
    out -= out.mean(axis=0)
    return out * deviation / out.std(axis=0)


def _train(
    options: LightBenchOptions,
    data: Path,
    exposure: str,
    clean: Path | None = None,
    truth: Light | None = None,
) -> dict[str, Any]:
    scene = gsut.load_dataset(data)
    settings = gsut.TrainOptions(
        steps=options.steps, max_gaussians=options.max_gaussians, scale=options.scale,
        exposure=exposure.split(",")[0], robust="--robust" in exposure,
        drop_blurred="--drop-blurred" in exposure, eval_every=options.steps,
        motion_blur=_EXPOSED if "--motion-blur" in exposure else None,
    )  # fmt: skip
    stages: dict[str, list[float]] = {}

    def look(loop: TrainingLoop, _: dict[str, Any]) -> bool:
        stages.update(loop.stopwatch.seconds)
        return True

    started = time.process_time()
    result = gsut.train(scene, settings, progress=False, watch=look)
    row = {"exposure": exposure, "cpu_seconds": time.process_time() - started}
    model = stages["light"][1] + (
        0.0 if settings.exposure == "off" else _first_look(scene, settings)
    )
    row["model_percent"] = 100 * model / sum(cpu for _, cpu in stages.values())
    names = ("psnr", "psnr_unit_gain", "psnr_color_corrected", "psnr_half_image")
    row |= {name: result.metrics[name] for name in names}
    if clean is None or truth is None:
        return row
    undisturbed = gsut.load_dataset(clean)
    row["psnr_truth"] = evaluate(result.gaussians, undisturbed, undisturbed.test_indices)["psnr"]
    light = result.metrics.get("light")
    if light is None:
        return row
    found = Light.from_dict(light, [view.name for view in scene.views])
    train = list(scene.train_indices)
    off = np.log(found.gains[train] / truth.gains[train])
    row["gain_percent"] = 100 * float(np.sqrt(np.mean((off - off.mean(axis=0)) ** 2)))
    angles = np.linspace(0, float(np.nanmax(field_angles(scene.cameras[0]))), 50)
    shapes = [
        np.ones((50, 3)) if each is None else each.at(angles)
        for each in (found.falloffs[0], truth.falloffs[0])
    ]
    apart = np.log(shapes[0] / shapes[1])
    row["falloff_percent"] = 100 * float(np.abs(apart - apart.mean(axis=0)).max())
    return row
