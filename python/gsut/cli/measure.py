"""`gsut measure`: distances between points of a scene."""

from __future__ import annotations

import argparse

import numpy as np

from gsut._core import InputError
from gsut.cli._flags import add_json, finite, print_json

HELP = "distances between points of a scene, by pixels of photographs"
DESCRIPTION = (
    "Prints where pixels of photographs, and points, lie in the dataset's coordinates and how far "
    "each is from the one before: in metres where the dataset is metric. Pixels come first."
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
    from gsut.view import find_point_in_photograph, open_stage

    pixels = [(name, _number(x), _number(y)) for name, x, y in arguments.pixel]
    if len(pixels) + len(arguments.point) < 2:
        raise InputError("a distance needs two of --pixel PHOTO X Y and --point X Y Z")
    if arguments.length is not None and not 0 < arguments.length < np.inf:
        raise InputError(f"--length must be above 0, found {arguments.length}")
    stage = open_stage(arguments.scene, None)
    points = np.array(
        [find_point_in_photograph(stage, name, (x, y)) for name, x, y in pixels] + arguments.point
    )
    distances = np.linalg.norm(np.diff(points, axis=0), axis=1)
    figures = {"points": points, "distances": distances, "total": distances.sum()}
    if arguments.length is not None:
        if not distances[0] > 0:
            raise InputError("the first two points are one; --length needs two")
        figures["scale"] = arguments.length / distances[0]
    if arguments.json:
        print_json(figures)
        return 0
    for number, point in enumerate(points):
        step = f", {distances[number - 1]:.6g} from the one before" if number else ""
        print(f"({', '.join(f'{value:.6g}' for value in point)}){step}")
    if len(points) > 2:
        print(f"{figures['total']:.6g} in all")
    if "scale" in figures:
        print(f"for this length: gsut edit {arguments.scene} --scale {figures['scale']:.6g} -o OUT")
    return 0


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise InputError(f"--pixel takes a photograph's name and two numbers, found {text!r}")
    return value
