"""`lab/run bench localize`: errors of localised photographs over the uncertainty that is stated."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

import gsut
from gsut.refine.pixel_rows import compute_square
from gsut.render import choose_solid
from random_scenes import subtract_poses
from tests.bench.harness import HALL, Benchmark, Column, Option, Row, Settings

_COVERED = 14.16  # of a chi-square law of three degrees of freedom: 99.73 %, as 3 sigma of one
_PATCH = 1 / 3  # of the image's sides: all that counts where few points are seen
Photograph = tuple[Any, np.ndarray, np.ndarray]  # lens, (H, W, 3) uint8, (H, W) bool
Change = Callable[[Photograph, int], Photograph]  # with a number for chance


def _scale_focal(factor: float) -> Change:
    def change(photograph: Photograph, _: int) -> Photograph:
        lens, pixels, mask = photograph
        params = np.array(lens.params)
        params[:2] *= factor
        return lens.with_params(params), pixels, mask

    return change


def _keep_patch(photograph: Photograph, number: int) -> Photograph:
    lens, pixels, mask = photograph
    rng = np.random.default_rng(number)
    height, width = mask.shape
    y, x = rng.uniform(0.2, 0.8 - _PATCH, 2) * [height, width]
    patch = np.zeros_like(mask)
    rows, columns = round(height * _PATCH), round(width * _PATCH)
    patch[int(y) : int(y) + rows, int(x) : int(x) + columns] = True
    return lens, pixels, mask & patch


def _light_evening(photograph: Photograph, _: int) -> Photograph:
    """Makes it darker, steeper and yellower, with a light from one side."""
    lens, pixels, mask = photograph
    side = np.linspace(0.6, 1.1, pixels.shape[1])[None, :, None]
    colors = 0.8 * (pixels / 255) ** 1.2 * [1.0, 0.92, 0.75] * side
    return lens, np.rint(255 * np.clip(colors, 0, 1)).astype(np.uint8), mask


CHANGES: dict[str, Change] = {
    "good lens": lambda photograph, _: photograph,
    "focal length 1 % too long": _scale_focal(1.01),
    "focal length 1 % too short": _scale_focal(0.99),
    "focal length 3 % too long": _scale_focal(1.03),
    "focal length 3 % too short": _scale_focal(0.97),
    "focal length 10 % too long": _scale_focal(1.1),
    "focal length 10 % too short": _scale_focal(0.9),
    "a ninth of the picture": _keep_patch,
    "other light": _light_evening,
}


def list_cases(settings: Settings) -> Iterator[Row]:
    """Lists what is done to the photographs before they are localised."""
    for data in settings.sets or (HALL,):
        for name, change in CHANGES.items():
            yield {"data": data, "photographs": name, "_change": change}


def measure(case: Row, settings: Settings) -> Row:
    """Localises some held-out photographs of a trained model."""
    trained = _train(case["data"], settings)
    indices = list(trained.scene.test_indices)
    indices = indices[:: max(1, len(indices) // settings.views)][: settings.views]
    tries = [_localize(case["_change"], k, index, trained) for k, index in enumerate(indices)]
    found = [each for each in tries if each is not None]
    row: Row = {"found": f"{len(found)} of {len(tries)}"}
    if found:
        errors, stated, squares, freedoms = map(np.array, zip(*found, strict=True))
        row |= {
            "error": float(np.median(errors)),
            "largest": float(errors.max()),
            "stated": float(np.median(stated)),
            "sigmas": float(np.sqrt(squares / 3).max()),
            "covered": int((squares <= _COVERED).sum()),
            "freedom": float(np.median(freedoms)),
        }
    return row


@functools.lru_cache(maxsize=1)
def _train(data: str, settings: Settings) -> Any:
    out = settings.folder / f"{data.replace('/', '_')}-localize"
    if not out.exists():
        options = gsut.TrainOptions(preset="fast", steps=settings.steps)
        gsut.train(gsut.load_dataset(settings.path(data)), options, out=out, progress=False)
    return gsut.load_run(out)


def _localize(
    change: Change, number: int, index: int, trained: Any
) -> tuple[float, float, float, float] | None:
    """Returns the centre's error, its standard deviation, and the error's square by the covariance.

    The last is the square of the whole pose's error, per degree of freedom. None if the photograph
    was refused.
    """
    scene = trained.scene
    lens, pixels, mask = change(
        (scene.camera(index), scene.image(index), scene.mask(index)), number
    )
    try:
        found = gsut.localize(
            pixels, scene, trained.gaussians, camera=lens, mask=mask,
            background=choose_solid(trained.options.background),
        )  # fmt: skip
    except gsut.SolveError:
        return None
    off = found.pose.center - scene.views[index].camera_center
    spread = found.pose.covariance[:3, :3]
    square = float(off @ np.linalg.solve(spread, off))
    error = subtract_poses(found.pose.camera_from_world, scene.views[index].camera_from_world)
    freedom = compute_square(error, found.pose.covariance)
    return float(np.linalg.norm(off)), float(np.sqrt(np.trace(spread))), square, freedom


BENCHMARK = Benchmark(
    help="photographs' poses against the truth: errors of centres over the stated uncertainty",
    columns=(
        Column("data"),
        Column("photographs"),
        Column("found", form="s"),
        Column("error", "error, median", "units", ".4f"),
        Column("largest", "largest", "units", ".4f"),
        Column("stated", "stated sigma", "units", ".4f"),
        Column("sigmas", "largest", "sigmas", ".1f"),
        Column("covered", "within 3 sigmas", form="d"),
        Column("freedom", "square per freedom, median", form=".2f"),
    ),
    cases=list_cases,
    measure=measure,
    options=(Option("views", 5, "held-out photographs"), Option("steps", 1000, "of the training")),
)
