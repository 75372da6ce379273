"""`gsut measure`: distances between points of a scene."""

from __future__ import annotations

import argparse

import numpy as np

from gsut._core import InputError
from gsut.cli._flags import add_json, finite, print_result

HELP = "distances between points of a scene, by pixels of photographs"
DESCRIPTION = (
    "Prints where pixels of photographs, and points, lie in the dataset's coordinates and how far "
    "each is from the one before, with its standard deviation: in metres where the dataset is "
    "metric. Pixels come first."
)


def add_flags(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scene", metavar="RUN|FILE|DATA", help="what is measured")
    parser.add_argument(
        "--pixel", nargs=3, action="append", default=[], metavar=("PHOTO", "X", "Y"),
        help="name of a photograph and a pixel of it; repeatable",
    )  # fmt: skip
    parser.add_argument(
        "--point", nargs=3, type=finite, action="append", default=[], metavar=("X", "Y", "Z"),
        help="in the dataset's coordinates; repeatable",
    )  # fmt: skip
    parser.add_argument(
        "--length", type=finite, metavar="L",
        help="how far the first two are apart in truth: prints the --scale for `gsut edit`",
    )  # fmt: skip
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
    from gsut.sfm import read_scale_sigma
    from gsut.view import find_point_in_photograph, open_stage

    pixels = [(name, _number(x), _number(y)) for name, x, y in arguments.pixel]
    if len(pixels) + len(arguments.point) < 2:
        raise InputError("a distance needs two of --pixel PHOTO X Y and --point X Y Z")
    if arguments.length is not None and not 0 < arguments.length < np.inf:
        raise InputError(f"--length must be above 0, found {arguments.length}")
    stage = open_stage(arguments.scene, None)
    seen = [find_point_in_photograph(stage, name, (x, y)) for name, x, y in pixels]
    points = np.array([point for point, _ in seen] + arguments.point)
    covariances = np.zeros((len(points), 3, 3))  # given points are exact
    covariances[: len(seen)] = np.reshape([each for _, each in seen], (-1, 3, 3))
    steps = np.diff(points, axis=0)
    distances = np.linalg.norm(steps, axis=1)
    along = steps / np.maximum(distances, np.finfo(float).tiny)[:, None]
    variances = np.einsum("ni,nij,nj->n", along, covariances[1:] + covariances[:-1], along)
    scale_sigma = None if stage.scene is None else read_scale_sigma(stage.scene.path)
    sigmas = np.sqrt(variances + ((scale_sigma or 0.0) * distances) ** 2)
    figures = {
        "points": points, "distances": distances, "sigmas": sigmas, "total": distances.sum(),
        "scale_sigma_percent": None if scale_sigma is None else 100 * scale_sigma,
    }  # fmt: skip
    if arguments.length is not None:
        if not distances[0] > 0:
            raise InputError("the first two points are one; --length needs two")
        figures["scale"] = arguments.length / distances[0]
    lines = []
    for number, point in enumerate(points):
        step = ""
        if number:
            length, sigma = distances[number - 1], sigmas[number - 1]
            step = f", {length:.6g} from the one before (+- {sigma:.2g}, one sigma)"
        lines.append(f"({', '.join(f'{value:.6g}' for value in point)}){step}")
    if len(points) > 2:
        lines.append(f"{figures['total']:.6g} in all")
    if scale_sigma is not None:
        lines.append(f"the scale is known to {100 * scale_sigma:.2g} %, which is included")
    if "scale" in figures:
        how = f"--scale {figures['scale']:.6g} -o OUT"
        lines.append(f"for this length: gsut edit {arguments.scene} {how}")
    return print_result(arguments, figures, lines)


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise InputError(f"--pixel takes a photograph's name and two numbers, found {text!r}")
    return value
