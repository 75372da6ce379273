"""`./run bench antialias`: images smaller and larger than the photographs, and other lenses."""

from __future__ import annotations

import argparse
import dataclasses
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

import gsut
from gsut.demo import make_demo_scene
from gsut.demo.dataset import render_views, whole_pixels
from gsut.demo.hall import make_hall
from gsut.demo.views import demo_camera
from gsut.gaussians import apply_low_pass, find_filter_radii
from gsut.lens import Camera
from gsut.render import PixelFilter, psnr, render
from tests.bench.report_rows import add_files, check_files, print_and_write

_SCALES = (0.25, 0.5, 1.0, 2.0)
_PIXELS = 0.3  # standard deviation of the low-pass filter
COLUMNS = (
    ("scene", "scene", ""),
    ("lens", "lens", ""),
    ("size, of the photographs'", "scale", "g"),
    ("no filter [dB]", "none", ".2f"),
    ("low-pass 0.3 px", "low_pass", ".2f"),
    ("pixel filter", "pixel_filter", ".2f"),
)
HELP = "aliasing: renders at other sizes and through other lenses, against truth"


@dataclasses.dataclass(frozen=True)
class AntialiasBenchOptions:
    """What is measured.

    Args:
        data: a dataset, trained on at half its size; None: the demo's hall, whose truth is traced.
        steps, max_gaussians: of the training.
        views: of the hall. size: of its images, pixels.
    """

    data: Path | None = None
    steps: int = 500
    max_gaussians: int = 30_000
    views: int = 40
    size: int = 200


def add_flags(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--data", type=Path, help="a dataset [default: the demo's hall]")
    for name in ("steps", "max_gaussians", "views", "size"):
        default = getattr(AntialiasBenchOptions, name)
        flag = "--" + name.replace("_", "-")
        parser.add_argument(flag, type=int, default=default, help=f"[{default}]")
    add_files(parser)


def run(arguments: argparse.Namespace) -> int:
    check_files(arguments)
    names = [field.name for field in dataclasses.fields(AntialiasBenchOptions)]
    options = AntialiasBenchOptions(**{name: getattr(arguments, name) for name in names})
    rows = run_antialias(options, lambda text: print(text, file=sys.stderr))
    print_and_write(rows, COLUMNS, arguments)
    return 0


def run_antialias(
    options: AntialiasBenchOptions, say: Callable[[str], None]
) -> list[dict[str, Any]]:
    """One row a lens and size: mean PSNR over held-out views."""
    with tempfile.TemporaryDirectory(prefix="gsut-antialias-") as folder:
        path = options.data or make_demo_scene(
            Path(folder) / "hall", options.views, 6, options.size, progress=False
        )
        scene = gsut.load_dataset(path)
        settings = gsut.TrainOptions(
            steps=options.steps, max_gaussians=options.max_gaussians, eval_every=0,
            scale=1.0 if options.data is None else 0.5,
        )  # fmt: skip
        say(f"training on {path}")
        result = gsut.train(scene, settings, progress=False)
        trained = result.scene
        cameras = [trained.camera(index) for index in trained.train_indices]
        pixels = PixelFilter(result.gaussians, cameras, trained.poses(trained.train_indices))
        made = _of_hall(options, scene) if options.data is None else _of_data(scene)
        rows = []
        for lens, scale, views in made:
            say(f"{lens} at {scale:g}")
            each = [_figures(result.gaussians, pixels, *view) for view in views]
            means = {name: float(np.mean([row[name] for row in each])) for name in each[0]}
            rows.append({"scene": scene.path.name, "lens": lens, "scale": scale} | means)
    return rows


def _figures(
    gaussians: gsut.Gaussians,
    pixels: PixelFilter,
    camera: Camera,
    pose: np.ndarray,
    truth: np.ndarray,
    mask: np.ndarray,
) -> dict[str, float]:
    radii = find_filter_radii(gaussians.means + gaussians.origin, [camera], pose[None], _PIXELS)
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


def _of_hall(options: AntialiasBenchOptions, scene: gsut.Scene) -> Iterator[tuple]:
    """(lens, size, (camera, pose, truth, mask) of every other held-out view)."""
    poses = [scene.views[index].camera_from_world for index in scene.test_indices[::2]]
    hall = make_hall(0)
    for lens in ("fisheye", "pinhole"):
        for scale in _SCALES:
            side = round(scale * options.size)
            plain = [0.6 * side, 0.6 * side, side / 2, side / 2]
            camera = (
                demo_camera(side) if lens == "fisheye" else Camera("pinhole", plain, side, side)
            )
            seen = render_views(hall, camera, [np.linalg.inv(pose) for pose in poses], False)
            mask = whole_pixels(camera)
            views = [(camera, pose, truth, mask) for pose, truth in zip(poses, seen, strict=True)]
            yield lens, scale, views


def _of_data(scene: gsut.Scene) -> Iterator[tuple]:
    for scale in _SCALES:
        shown = scene if scale == 2.0 else scene.scaled(scale / 2.0)
        views = [
            (shown.camera(i), shown.views[i].camera_from_world, shown.image(i), shown.mask(i))
            for i in shown.test_indices[::3]
        ]
        yield "its own", scale, views
