"""`./run bench few`: few photographs with the points that they give themselves, and without any."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np

import gsut
from gsut._core import InputError
from gsut.data import Scene
from gsut.data.scene import project_points, read_depth
from gsut.training import TrainingLoop
from lab.demo_tracer import make_demo_scene
from tests.bench.commands import run_gsut
from tests.bench.harness import HALL, Benchmark, Column, Option, Row, Settings

STREET = "captures/lund"  # photographs by a phone, without poses
# Dataset -> training views that are kept; 0: all of them.
VIEWS: dict[str, tuple[int, ...]] = {
    HALL: (10, 0),
    "sponza_fisheye": (10,),
    "helmet_distorted_rs": (12,),
    "fox": (12,),
    STREET: (0,),
}
POINTS = ("none", "all")  # of the dataset
_NEAR = 0.05  # of the true distance: a first Gaussian there counts as found
_REACH = 2.0  # pixels around a first Gaussian that it covers
_WIDE = "220 degrees"  # lens through which the hall is seen once more
_WIDE_FIELD = 220.0  # degrees
_WIDE_VIEWS = 10
_WIDE_SIZE = 200  # pixels a side


def list_cases(settings: Settings) -> Iterator[Row]:
    """Lists datasets by number of views and origin of the points."""
    sets = settings.sets or tuple(VIEWS)
    scenes = [
        (data, "", int(views))
        for data in sets
        for views in settings.views or VIEWS.get(data, (10,))
    ]
    if HALL in sets:
        scenes.append((HALL, _WIDE, _WIDE_VIEWS))
    for data, lens, views in scenes:
        for points in settings.points:
            for seed in settings.seeds:
                yield {"data": data, "lens": lens, "views": str(views or "all"), "points": points,
                       "seed": str(seed), "_views": views, "_seed": seed}  # fmt: skip


def measure(case: Row, settings: Settings) -> Row:
    """Trains on some views and judges on the held-out ones."""
    scene = choose_views(load(case["data"], case["lens"], settings), case["_views"])
    scene = replace_points(scene, case["points"])
    options = gsut.TrainOptions(preset="fast", steps=settings.steps, seed=case["_seed"])
    began, first = time.process_time(), []

    def note_first(loop: TrainingLoop, _: Row) -> bool:
        if not first:
            first.append((loop.gaussians.means.copy(), time.process_time() - began))
        return True

    trained = gsut.train(scene, options, progress=False, watch=note_first)
    [(means, sought)] = first
    return {
        "given": len(scene.points),
        "first": len(means),
        "covered": measure_coverage(scene.centred, means),
        "psnr": trained.metrics["psnr"],
        "first_seconds": sought,
        "cpu_seconds": time.process_time() - began,
    }


def load(data: str, lens: str, settings: Settings) -> Scene:
    """Loads a dataset, with images no larger than the option `side`; of photographs finds poses."""
    path = settings.path(data)
    if lens == _WIDE:
        angle = np.radians(_WIDE_FIELD / 2)
        focal = _WIDE_SIZE / 2 / angle
        camera = gsut.Camera(
            "kannala_brandt", [focal, focal, _WIDE_SIZE / 2, _WIDE_SIZE / 2], _WIDE_SIZE,
            _WIDE_SIZE, valid_field_angle=angle,
        )  # fmt: skip
        path = settings.make(
            "hall_220", lambda to: make_demo_scene(to, camera=camera, progress=False)
        )
    elif data == STREET:
        path, photographs = settings.folder / "street", path
        run_gsut(["poses", str(photographs)], path)
    scene = gsut.load_dataset(path)
    longest = max(max(camera.width, camera.height) for camera in scene.cameras)
    return scene.scale_images(settings.side / longest) if longest > settings.side else scene


def choose_views(scene: Scene, count: int) -> Scene:
    """Keeps `count` training views, evenly spread; 0: all."""
    train = scene.train_indices
    if not 0 < count < len(train):
        return scene
    rows = np.linspace(0, len(train) - 1, count).round().astype(int)
    return scene.replace(train_indices=[train[row] for row in rows])


def replace_points(scene: Scene, origin: str) -> Scene:
    """Replaces the points by those of an origin in `POINTS`.

    Raises:
        InputError: an unknown origin.
    """
    if origin not in POINTS:
        raise InputError(f"--points: no {origin!r}; there are {', '.join(POINTS)}")
    if origin == "all":
        return scene
    return scene.replace(points=np.zeros((0, 3)), point_colors=np.zeros((0, 3), np.uint8))


def measure_coverage(scene: Scene, points: np.ndarray) -> float | None:
    """Measures the percentage of held-out pixels whose surface has a first Gaussian near it.

    Near is within two pixels and five hundredths of the true distance. None without depth files.
    """
    found, asked = 0, 0
    for view in scene.test_indices:
        truth = read_depth(scene, view)
        if truth is None:
            return None
        camera = scene.camera(view)
        in_camera, pixels, valid = project_points(camera, scene.views[view].motion, points)
        away = np.linalg.norm(in_camera[valid], axis=1)
        rows, columns = np.indices((camera.height, camera.width))
        places = np.stack([rows, columns], -1) * truth.shape[0] // camera.height
        known = truth[places[..., 0], places[..., 1]]
        counts = scene.mask(view) & (known > 0)
        covered = np.zeros(counts.shape, bool)
        column, row = pixels[valid].astype(int).T
        reach = int(_REACH)
        for down in range(-reach, reach + 1):
            for right in range(-reach, reach + 1):
                y, x = row + down, column + right
                inside = (y >= 0) & (x >= 0) & (y < camera.height) & (x < camera.width)
                y, x, d = y[inside], x[inside], away[inside]
                near = np.abs(d / np.maximum(known[y, x], 1e-9) - 1) < _NEAR
                covered[y[near], x[near]] = True
        found += np.count_nonzero(covered & counts)
        asked += np.count_nonzero(counts)
    return 100 * found / asked


BENCHMARK = Benchmark(
    help="few photographs: no points, beside points of all views",
    columns=(
        Column("data"),
        Column("lens"),
        Column("views"),
        Column("points"),
        Column("seed"),
        Column("given", "points given", form=",d"),
        Column("first", "first Gaussians", form=",d"),
        Column("covered", "held-out pixels with one", "%", ".0f"),
        Column("psnr", "held-out PSNR", "dB", ".2f"),
        Column("first_seconds", "first Gaussians", "CPU-s", ".1f"),
        Column("cpu_seconds", "training", "CPU-s", ".1f"),
    ),
    cases=list_cases,
    measure=measure,
    options=(
        Option("views", (), "training views to keep, evenly spread; 0: all"),
        Option("points", POINTS, "none, or those of the dataset"),
        Option("seeds", (0, 1), "of trainings"),
        Option("steps", 1000, "of each training"),
        Option("side", 480, "longest of the images, pixels"),
    ),
)
