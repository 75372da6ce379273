"""`./run bench localize`: errors of localised photographs over the stated uncertainty."""

from __future__ import annotations

import argparse
import dataclasses
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import gsut
from gsut.cli._flags import add_json, print_json
from gsut.demo import make_demo_scene
from gsut.render import solid

HELP = "photographs' poses against the truth: errors over the stated uncertainty, case by case"
_STEPS = 1000
_COVERED = 14.16  # of a chi-square law of three degrees of freedom: 99.73 %, as 3 sigma of one
_PATCH = 1 / 3  # of the image's sides: all that counts where few points are seen
Photograph = tuple[Any, np.ndarray, np.ndarray]  # lens, (H, W, 3) uint8, (H, W) bool


@dataclasses.dataclass(frozen=True)
class Case:
    """What is done to a photograph before it is localised.

    Args:
        name: for the table.
        make: takes the photograph and a number for chance, gives another.
    """

    name: str
    make: Callable[[Photograph, int], Photograph]


def _focal(factor: float) -> Callable[[Photograph, int], Photograph]:
    def make(photograph: Photograph, _: int) -> Photograph:
        lens, pixels, mask = photograph
        params = np.array(lens.params)
        params[:2] *= factor
        return lens.with_params(params), pixels, mask

    return make


def _patch(photograph: Photograph, number: int) -> Photograph:
    lens, pixels, mask = photograph
    rng = np.random.default_rng(number)
    height, width = mask.shape
    y, x = rng.uniform(0.2, 0.8 - _PATCH, 2) * [height, width]
    patch = np.zeros_like(mask)
    rows, columns = round(height * _PATCH), round(width * _PATCH)
    patch[int(y) : int(y) + rows, int(x) : int(x) + columns] = True
    return lens, pixels, mask & patch


def _other_light(photograph: Photograph, _: int) -> Photograph:
    """Evening: darker, steeper, yellower, and a light from one side."""
    lens, pixels, mask = photograph
    side = np.linspace(0.6, 1.1, pixels.shape[1])[None, :, None]
    colors = 0.8 * (pixels / 255) ** 1.2 * [1.0, 0.92, 0.75] * side
    return lens, np.rint(255 * np.clip(colors, 0, 1)).astype(np.uint8), mask


CASES: tuple[Case, ...] = (
    Case("good lens", lambda photograph, _: photograph),
    *(
        Case(f"focal length {'+' if factor > 1 else '-'}{abs(factor - 1):.0%}", _focal(factor))
        for factor in (1.01, 0.99, 1.03, 0.97, 1.1, 0.9)
    ),
    Case("a ninth of the picture", _patch),
    Case("other light", _other_light),
)


def add_flags(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "runs", nargs="*", metavar="RUN", help="finished runs [default: the demo's hall]"
    )
    parser.add_argument(
        "--views", type=int, default=5, metavar="N", help="held-out photographs [default 5]"
    )
    parser.add_argument("--only", metavar="WORDS", default="", help="cases with these words")
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        for name in arguments.runs or [_demo_run(Path(folder))]:
            found = judge(name, arguments.views, arguments.only)
            rows += found
            if not arguments.json:
                _print(Path(name).name, found)
    if arguments.json:
        print_json(rows)
    return 0


def _demo_run(folder: Path) -> Path:
    print("making and training the demo's hall", file=sys.stderr)
    data = make_demo_scene(folder / "hall", progress=False)
    options = gsut.TrainOptions(preset="fast", steps=_STEPS)
    gsut.train(gsut.load_dataset(data), options, out=folder / "run", progress=False)
    return folder / "run"


def judge(folder: str | Path, views: int, only: str = "") -> list[dict[str, Any]]:
    """One row a case: what became of some held-out photographs of a run.

    Args:
        folder: of the run. views: how many photographs. only: of the cases' names.
    """
    trained = gsut.load_run(folder)
    scene = trained.scene
    indices = list(scene.test_indices)
    indices = indices[:: max(1, len(indices) // views)][:views]
    rows = []
    for case in CASES:
        if only not in case.name:
            continue
        tries = [_localized(case, number, index, trained) for number, index in enumerate(indices)]
        found = [each for each in tries if each is not None]
        row: dict[str, Any] = {
            "case": case.name, "photographs": len(tries), "found": len(found),
        }  # fmt: skip
        if found:
            errors, stds, squares, focals = map(np.array, zip(*found, strict=True))
            row |= {
                "error_median": float(np.median(errors)),
                "error_max": float(errors.max()),
                "std_median": float(np.median(stds)),
                "sigmas_median": float(np.median(np.sqrt(squares / 3))),
                "sigmas_max": float(np.sqrt(squares / 3).max()),
                "covered": int((squares <= _COVERED).sum()),
                "focal_scale": float(np.median(focals)),
            }
        rows.append(row)
    return rows


def _localized(
    case: Case, number: int, index: int, trained: Any
) -> tuple[float, float, float, float] | None:
    """Error and standard deviation of the centre, both as lengths, the error's square by the
    covariance, and the focal length's factor; None where the photograph was refused."""
    scene = trained.scene
    lens, pixels, mask = case.make(
        (scene.camera(index), scene.image(index), scene.mask(index)), number
    )
    try:
        found = gsut.localize(
            pixels, scene, trained.gaussians, camera=lens, mask=mask,
            background=solid(trained.options.background),
        )  # fmt: skip
    except gsut.SolveError:
        return None
    off = found.pose.center - scene.views[index].camera_center
    spread = found.pose.covariance[:3, :3]
    square = float(off @ np.linalg.solve(spread, off))
    length = float(np.linalg.norm(off))
    return length, float(np.sqrt(np.trace(spread))), square, found.focal_scale


def _print(name: str, rows: Sequence[dict[str, Any]]) -> None:
    print(
        f"\n{name}: errors of centres (dataset's units), and over the stated sigma, rms of 3 axes"
    )
    heads = ("error", "worst", "stated", "/sigma", "worst", "covered")
    print(" " * 24 + "   found " + "".join(f"{head:>10}" for head in heads))
    for row in rows:
        text = f"{row['case']:24} {row['found']:3}/{row['photographs']:<3}"
        if row["found"]:
            text += (
                f" {row['error_median']:9.4f} {row['error_max']:9.4f} {row['std_median']:9.4f} "
                f"{row['sigmas_median']:9.2f} {row['sigmas_max']:9.2f} "
                f"{row['covered']:6}/{row['found']:<3}"
            )
        print(text)
    missed = sum(row["found"] - row["covered"] for row in rows if row["found"])
    print(f"{missed} errors not covered")
