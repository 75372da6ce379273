"""`./run bench floaters`: what hangs in the air, and where the sky ends up.

In the hall against known truth: a floater is nearer than half of the true distance. In photographs
of which the upper part is sky: nearer than the farthest of the points (99 of 100) below it.
"""

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
from gsut.data.points import format_points_ply
from gsut.demo import make_demo_scene
from gsut.demo.dataset import distances
from gsut.demo.hall import HALF_X, Hall, make_hall
from gsut.render import psnr
from tests.bench.report_rows import add_files, check_files, print_and_write

_NEAR = 0.5  # of the true distance, below which a pixel shows a floater
_REACH = 99.0  # percentile of the points' distances, beyond which the sky has to lie
_OPAQUE = 0.5  # alpha from which a pixel counts as covered
_SMALLEST = 6  # pixels of one blob
_IN_WINDOW = 0.02  # metres within which a surface is the window itself
_BEYOND = 1.5  # of the distance to the window: what is further lies outside
_LOW, _HIGH = np.array([0.85, 0.75, 0.62]), np.array([0.25, 0.45, 0.80])  # sky by height
_CLOUDS = 0.08
_CLOUDLESS = np.array([0.55, 0.70, 0.92])
HELP = "floaters and sky: blobs before what is there, in a hall with open windows or in the sky"
COLUMNS = (
    ("way", "way", ""),
    ("held out [dB]", "psnr", ".2f"),
    ("of it the sky", "psnr_sky", ".2f"),
    ("open left black", "psnr_black", ".2f"),
    ("blobs a view", "blobs", ".2f"),
    ("views with some [%]", "with_blobs_percent", ".0f"),
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
        data: a dataset whose sky is looked at, with first Gaussians there and without; None: the
            hall.
        sky: of the height of its photographs, from the top.
        scale: of its photographs.
        steps, max_gaussians: of each training.
        views, size: of the hall. cloudless: its sky has one colour.
    """

    data: Path | None = None
    sky: float = 1 / 3
    scale: float = 1.0
    steps: int = 800
    max_gaussians: int = 30_000
    views: int = 40
    size: int = 200
    cloudless: bool = False


def add_flags(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--data", type=Path, help="a dataset under a sky [default: the hall]")
    for field in dataclasses.fields(FloatersBenchOptions)[1:]:
        flag, kind = "--" + field.name.replace("_", "-"), type(field.default)
        if kind is bool:
            parser.add_argument(flag, action="store_true", help="the hall's sky has one colour")
            continue
        parser.add_argument(flag, type=kind, default=field.default, help=f"[{field.default:.3g}]")
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
    training: dict[str, Any] = {
        "steps": options.steps, "max_gaussians": options.max_gaussians, "eval_every": 0,
    }  # fmt: skip
    if options.data is not None:
        scene, rows = gsut.load_dataset(options.data), []
        # A number of first Gaussians leaves out those of the sky.
        for count in (None, min(len(scene.points), options.max_gaussians)):
            way = "as it is" if count is None else f"--init-count {count}"
            say(way)
            settings = gsut.TrainOptions(scale=options.scale, init_count=count, **training)
            result = gsut.train(scene, settings, progress=False)
            rows.append({"way": way} | blobs_in_sky(result, options.sky))
        return rows
    with tempfile.TemporaryDirectory(prefix="gsut-floaters-") as folder:
        data = open_hall(Path(folder), options.views, 6, options.size, options.cloudless)
        rows = []
        for way, values in WAYS.items():
            say(way)
            settings = gsut.TrainOptions(exposure="off", **training, **values)
            result = gsut.train(gsut.load_dataset(data), settings, progress=False)
            rows.append({"way": way} | floaters(result.gaussians, gsut.load_dataset(data)))
    return rows


def open_hall(
    folder: Path, views: int, test_views: int, size: int, cloudless: bool = False
) -> Path:
    """The demo's hall, its stained glass gone: a sky without end behind the windows."""
    data = make_demo_scene(folder / "hall", views, test_views, size, progress=False)
    scene, hall = gsut.load_dataset(data), make_hall(0)
    shutil.rmtree(data / "depth", ignore_errors=True)
    for index, view in enumerate(scene.views):
        _, sky, directions = _truth(hall, scene, index)
        image = scene.image(index).copy()
        shown = _CLOUDLESS if cloudless else sky_colors(directions[sky])
        image[sky] = np.rint(255 * shown)
        cv2.imwrite(str(data / view.name), image[..., ::-1])
    inside = ~_in_window(hall, scene.points)
    kept = format_points_ply(scene.points[inside], scene.point_colors[inside])
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
        mask, seen_sky = scene.mask(index), sky & scene.mask(index)
        shown, at = _seen(gaussians, scene, index)
        truth = scene.image(index).astype(np.float32) / np.float32(255)
        image = np.clip(shown.image, 0.0, 1.0)
        behind = np.float32(0.0) if shown.behind is None else shown.behind
        black = np.clip(shown.image - (1.0 - shown.alpha)[..., None] * behind, 0.0, 1.0)
        rows.append({
            "psnr": psnr(image, truth, mask), "psnr_black": psnr(black, truth, mask),
            "psnr_sky": psnr(image, truth, seen_sky) if seen_sky.any() else np.nan,
            "beyond_percent": 100 * np.mean(at[seen_sky] > _BEYOND * away[seen_sky])
            if seen_sky.any() else np.nan,
            **_near(shown, at < _NEAR * away, mask),
        })  # fmt: skip
    return {name: float(np.nanmean([row[name] for row in rows])) for name in rows[0]}


def blobs_in_sky(result: gsut.TrainResult, share: float) -> dict[str, float]:
    """Means over the held-out views' upper `share`; `psnr` as training gives it."""
    scene, rows = result.scene, []
    for index in scene.test_indices:
        sky = scene.mask(index).copy()
        sky[round(share * len(sky)) :] = False
        shown, at = _seen(result.gaussians, scene, index)
        points = np.linalg.norm(scene.points - scene.views[index].camera_center, axis=1)
        rows.append(_near(shown, at < np.percentile(points, _REACH), sky))
    means = {name: float(np.mean([row[name] for row in rows])) for name in rows[0]}
    return {"psnr": result.metrics["psnr"]} | means


def _seen(gaussians: gsut.Gaussians, scene: gsut.Scene, index: int) -> tuple[Any, np.ndarray]:
    """A view as it is rendered, and (H, W) its expected distances."""
    view = scene.views[index]
    shown = gsut.render(gaussians, scene.camera(index), view.motion, background=None)
    return shown, shown.depth / np.maximum(shown.alpha, np.finfo(np.float32).tiny)


def _near(shown: Any, nearer: np.ndarray, among: np.ndarray) -> dict[str, float]:
    """What is covered and `nearer` (H, W) than it should be, `among` these pixels (H, W)."""
    near = among & (shown.alpha > _OPAQUE) & nearer
    _, _, found, _ = cv2.connectedComponentsWithStats(near.astype(np.uint8))
    blobs = int(np.count_nonzero(found[1:, cv2.CC_STAT_AREA] >= _SMALLEST))
    return {
        "blobs": blobs,
        "with_blobs_percent": 100.0 * (blobs > 0),
        "near_percent": 100 * near.sum() / among.sum(),
        "open_percent": 100 * float(np.mean(1.0 - shown.alpha[among])),
    }
