"""`./run bench antialias`: renders at other sizes and through other lenses, against truth."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from typing import Any

import numpy as np

import gsut
from gsut.demo import make_demo_scene
from gsut.demo.dataset import find_whole_pixels, render_views
from gsut.demo.hall import make_hall
from gsut.demo.views import make_camera
from gsut.gaussians import apply_low_pass, find_filter_radii
from gsut.lens import Camera
from gsut.render import PixelFilter, psnr, render
from tests.bench.harness import HALL, Benchmark, Column, Option, Row, Settings

_SCALES = (0.25, 0.5, 1.0, 2.0)  # of the photographs' size
_LOW_PASS_PX = 0.3  # standard deviation of the low-pass filter


def list_cases(settings: Settings) -> Iterator[Row]:
    """Lists the hall through two lenses, and a dataset through its own, at each size."""
    for data in settings.sets or (HALL, "sponza_fisheye"):
        for lens in ("fisheye", "pinhole") if data == HALL else ("its own",):
            for scale in _SCALES:
                yield {"data": data, "lens": lens, "scale": f"{scale:g}", "_scale": scale}


def measure(case: Row, settings: Settings) -> Row:
    """Compares renders of a trained model with held-out views; the hall's are traced."""
    scene, gaussians, pixels = _train(case["data"], settings)
    of_hall = case["data"] == HALL
    views = (_trace_hall if of_hall else _scale_views)(scene, case, settings)
    each = [_compare(gaussians, pixels, *view) for view in views]
    return {name: float(np.mean([row[name] for row in each])) for name in each[0]}


@functools.lru_cache(maxsize=1)
def _train(data: str, settings: Settings) -> tuple[Any, Any, PixelFilter]:
    """Trains on the hall, or on a dataset at half size: scene, Gaussians, filter."""
    size = settings.size
    path = (
        settings.make(f"hall-{size}", lambda p: make_demo_scene(p, 40, 6, size, progress=False))
        if data == HALL
        else settings.path(data)
    )
    scene = gsut.load_dataset(path)
    options = gsut.TrainOptions(
        steps=settings.steps, max_gaussians=settings.max_gaussians, eval_every=0,
        scale=1.0 if data == HALL else 0.5,
    )  # fmt: skip
    result = gsut.train(scene, options, progress=False)
    cameras = [result.scene.camera(index) for index in result.scene.train_indices]
    poses = result.scene.poses(result.scene.train_indices)
    return scene, result.gaussians, PixelFilter(result.gaussians, cameras, poses)


def _trace_hall(scene: gsut.Scene, case: Row, settings: Settings) -> list[tuple]:
    """Traces every other held-out view: camera, pose, picture, mask."""
    poses = [scene.views[index].camera_from_world for index in scene.test_indices[::2]]
    side = round(case["_scale"] * settings.size)
    camera = make_camera(side)
    if case["lens"] == "pinhole":
        camera = Camera("pinhole", [0.6 * side, 0.6 * side, side / 2, side / 2], side, side)
    seen = render_views(make_hall(0), camera, [np.linalg.inv(pose) for pose in poses], False)
    mask = find_whole_pixels(camera)
    return [(camera, pose, picture, mask) for pose, picture in zip(poses, seen, strict=True)]


def _scale_views(scene: gsut.Scene, case: Row, settings: Settings) -> list[tuple]:
    """Scales every third held-out photograph: camera, pose, picture, mask."""
    shown = scene if case["_scale"] == 2.0 else scene.scale_images(case["_scale"] / 2.0)
    return [
        (shown.camera(i), shown.views[i].camera_from_world, shown.image(i), shown.mask(i))
        for i in shown.test_indices[::3]
    ]


def _compare(
    gaussians: gsut.Gaussians,
    pixels: PixelFilter,
    camera: Camera,
    pose: np.ndarray,
    truth: np.ndarray,
    mask: np.ndarray,
) -> dict[str, float]:
    radii = find_filter_radii(
        gaussians.means + gaussians.origin, [camera], pose[None], _LOW_PASS_PX
    )
    drawn = {
        "none": gaussians,
        "low_pass": apply_low_pass(gaussians, radii.astype(np.float32)),
        "pixel_filter": pixels.of(camera, pose),
    }
    truth = truth.astype(np.float32) / np.float32(255)
    return {
        name: psnr(np.clip(render(g, camera, pose, background=None).image, 0, 1), truth, mask)
        for name, g in drawn.items()
    }


BENCHMARK = Benchmark(
    help="aliasing: held-out PSNR of renders at other sizes and through other lenses, by filter",
    columns=(
        Column("data"),
        Column("lens"),
        Column("scale", "size"),
        Column("none", "no filter", "dB", ".2f"),
        Column("low_pass", "low-pass of 0.3 px", "dB", ".2f"),
        Column("pixel_filter", "pixel filter", "dB", ".2f"),
    ),
    cases=list_cases,
    measure=measure,
    options=(
        Option("steps", 500, "of the training"),
        Option("max_gaussians", 30_000, "of the training"),
        Option("size", 200, "of the hall's images, pixels"),
    ),
)
