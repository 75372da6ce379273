"""`./run bench floaters`: what hangs in the air, and where the sky ends up, against known truth."""

from __future__ import annotations

import argparse
import dataclasses
import shutil
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np

import gsut
from gsut.data import points_ply
from gsut.demo import make_demo_scene
from gsut.demo.dataset import distances
from gsut.demo.hall import HALF_X, Hall, make_hall
from gsut.render import psnr
from tests.bench.report_rows import add_files, check_files, print_and_write

_NEAR = 0.5  # of the true distance, below which a pixel shows a floater
_OPAQUE = 0.5  # alpha from which a pixel counts as covered
_SMALLEST = 6  # pixels of one blob
_IN_WINDOW = 0.02  # metres within which a surface is the window itself
_BEYOND = 1.5  # of the distance to the window: what is further lies outside
_LOW, _HIGH = np.array([0.85, 0.75, 0.62]), np.array([0.25, 0.45, 0.80])  # sky by height
_CLOUDS = 0.08
HELP = "floaters and sky: blobs before what is there, counted in a hall with open windows"
COLUMNS = (
    ("way", "way", ""),
    ("held out [dB]", "psnr", ".2f"),
    ("of it the sky", "psnr_sky", ".2f"),
    ("open left black", "psnr_black", ".2f"),
    ("blobs a view", "blobs", ".2f"),
    ("their pixels [%]", "near_percent", ".3f"),
    ("sky beyond the windows [%]", "beyond_percent", ".0f"),
    ("never covered [%]", "open_percent", ".2f"),
)
WAYS: dict[str, dict[str, Any]] = {
    "as it is": {},
    "--background 0,0,0": {"background": (0.0, 0.0, 0.0)},
    "--noise": {"noise": True},
    "--opacity-regularizer 0": {"opacity_regularizer": 0.0},
}


@dataclasses.dataclass(frozen=True)
class FloatersBenchOptions:
    """What is measured.

    Args:
        steps, max_gaussians: of each training.
        views, size: of the hall.
    """

    steps: int = 800
    max_gaussians: int = 30_000
    views: int = 40
    size: int = 200


def add_flags(parser: argparse.ArgumentParser) -> None:
    for field in dataclasses.fields(FloatersBenchOptions):
        flag = "--" + field.name.replace("_", "-")
        parser.add_argument(flag, type=int, default=field.default, help=f"[{field.default}]")
    add_files(parser)


def run(arguments: argparse.Namespace) -> int:
    check_files(arguments)
    names = [field.name for field in dataclasses.fields(FloatersBenchOptions)]
    options = FloatersBenchOptions(**{name: getattr(arguments, name) for name in names})
    rows = run_floaters(options, lambda text: print(text, file=sys.stderr))
    print_and_write(rows, COLUMNS, arguments)
    return 0


def run_floaters(options: FloatersBenchOptions, say: Callable[[str], None]) -> list[dict[str, Any]]:
    """One row a way to train."""
    with tempfile.TemporaryDirectory(prefix="gsut-floaters-") as folder:
        data = open_hall(Path(folder), options.views, 6, options.size)
        rows = []
        for way, values in WAYS.items():
            say(way)
            settings: dict[str, Any] = {
                "steps": options.steps, "max_gaussians": options.max_gaussians, "eval_every": 0,
                "exposure": "off", **values,
            }  # fmt: skip
            result = gsut.train(
                gsut.load_dataset(data), gsut.TrainOptions(**settings), progress=False
            )
            rows.append({"way": way} | floaters(result.gaussians, gsut.load_dataset(data)))
    return rows


def open_hall(folder: Path, views: int, test_views: int, size: int) -> Path:
    """The demo's hall, its stained glass gone: a sky without end behind the windows."""
    data = make_demo_scene(folder / "hall", views, test_views, size, progress=False)
    scene, hall = gsut.load_dataset(data), make_hall(0)
    shutil.rmtree(data / "depth", ignore_errors=True)
    for index, view in enumerate(scene.views):
        _, sky, directions = _truth(hall, scene, index)
        image = scene.image(index).copy()
        image[sky] = np.rint(255 * sky_colors(directions[sky]))
        cv2.imwrite(str(data / view.name), image[..., ::-1])
    inside = ~_in_window(hall, scene.points)
    kept = points_ply(scene.points[inside], scene.point_colors[inside])
    (data / "points3D.ply").write_bytes(kept)
    return data


def sky_colors(directions: np.ndarray) -> np.ndarray:
    """(n, 3) colours of a smooth sky with clouds in unit directions (n, 3), z up."""
    height = np.clip(directions[:, 2:], 0.0, 1.0)
    clouds = np.sin(9.0 * directions[:, 1:2] + 4.0 * np.sin(7.0 * directions[:, 2:]))
    return np.clip(_LOW + height * (_HIGH - _LOW) + _CLOUDS * clouds, 0.0, 1.0)


def _in_window(hall: Hall, points: np.ndarray) -> np.ndarray:
    """(n,) whether points (n, 3) lie on a window's opening."""
    found = np.zeros(len(points), bool)
    for window in hall.windows:
        off = np.abs(points - [HALF_X, window.y, window.z + window.height / 2])
        found |= np.all(off < [_IN_WINDOW, window.width / 2, window.height / 2], axis=1)
    return found


def _truth(hall: Hall, scene: gsut.Scene, index: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(H, W) distances, (H, W) sky, there the windows' distances, (H, W, 3) rays in the world."""
    rays, valid = scene.camera(index).rays()
    pose = np.linalg.inv(scene.views[index].camera_from_world)
    away, sky = np.full(valid.shape, np.inf), np.zeros(valid.shape, bool)
    directions = np.nan_to_num(rays) @ pose[:3, :3].T
    away[valid] = distances(hall, pose, rays[valid])
    sky[valid] = _in_window(hall, pose[:3, 3] + away[valid, None] * directions[valid])
    return away, sky, directions


def floaters(gaussians: gsut.Gaussians, scene: gsut.Scene) -> dict[str, float]:
    """Means over the held-out views; see COLUMNS."""
    hall, rows = make_hall(0), []
    for index in scene.test_indices:
        away, sky, _ = _truth(hall, scene, index)
        camera, mask = scene.camera(index), scene.mask(index)
        shown = gsut.render(gaussians, camera, scene.views[index].motion, background=None)
        truth = scene.image(index).astype(np.float32) / np.float32(255)
        image = np.clip(shown.image, 0.0, 1.0)
        behind = np.float32(0.0) if shown.behind is None else shown.behind
        black = np.clip(shown.image - (1.0 - shown.alpha)[..., None] * behind, 0.0, 1.0)
        covered = mask & (shown.alpha > _OPAQUE)
        at = shown.depth / np.maximum(shown.alpha, np.finfo(np.float32).tiny)
        near = covered & (at < _NEAR * away)
        _, _, found, _ = cv2.connectedComponentsWithStats(near.astype(np.uint8))
        blobs = int(np.count_nonzero(found[1:, cv2.CC_STAT_AREA] >= _SMALLEST))
        seen_sky = sky & mask
        rows.append({
            "psnr": psnr(image, truth, mask), "blobs": blobs,
            "psnr_black": psnr(black, truth, mask),
            "near_percent": 100 * near.sum() / mask.sum(),
            "open_percent": 100 * float(np.mean(1.0 - shown.alpha[mask])),
            "psnr_sky": psnr(image, truth, seen_sky) if seen_sky.any() else np.nan,
            "beyond_percent": 100 * np.mean(at[seen_sky] > _BEYOND * away[seen_sky])
            if seen_sky.any() else np.nan,
        })  # fmt: skip
    return {name: float(np.nanmean([row[name] for row in rows])) for name in rows[0]}
