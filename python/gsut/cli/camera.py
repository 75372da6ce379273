"""`gsut camera`: converts a lens, finds calibrated lenses by name."""

from __future__ import annotations

import argparse
import dataclasses
import math
from pathlib import Path
from typing import Any

from gsut.cli._flags import Number, add_json, print_result
from gsut.files import refuse_existing
from gsut.system import format_command

HELP = "convert a lens into another model, find one by the camera's name"
DESCRIPTION = "Works on lens files and on a database of calibrated lenses."
_LINES = 20  # of the table of lenses found


def add_flags(parser: argparse.ArgumentParser) -> None:
    actions = parser.add_subparsers(metavar="ACTION", required=True)
    _add_convert(actions)
    find = actions.add_parser(
        "find",
        help="find calibrated lenses by name",
        description="Lists lenses of real cameras, calibrated by others (Gyroflow's lens profiles, "
        "CC0), whose names hold all WORDS, the best first. Their names serve as --camera: starts "
        "of a search, not truth.",
    )
    find.add_argument("words", metavar="WORDS", nargs="+", help="such as: hero9 max wide")
    add_json(find)
    find.set_defaults(action=_find)


def run(arguments: argparse.Namespace) -> int:
    return arguments.action(arguments)


def _find(arguments: argparse.Namespace) -> int:
    from gsut.lens import find_lens, find_lenses

    found = find_lenses(arguments.words)
    if not found:
        find_lens(" ".join(arguments.words))  # says which word is to blame
    shown = found[:_LINES]
    rows = [
        {**dataclasses.asdict(p), "name": p.name, "fov_degrees": p.fov_degrees,
         "doubts": p.doubts}
        for p in shown
    ]  # fmt: skip
    lines = [f"{'field':>7} {'size':>11} {'readout':>8} {'residual':>9}  name"]
    for p in shown:
        field = "-" if p.fov_degrees is None else f"{p.fov_degrees:.1f}"
        readout = f"{p.readout_ms:.1f} ms" if p.readout_ms else "-"
        note = f" (doubtful: {', '.join(p.doubts)})" if p.doubts else ""
        size_text = f"{p.width} x {p.height}"
        lines.append(f"{field:>6}° {size_text:>11} {readout:>8} {p.rms:6.2f} px  {p.name}{note}")
    name = format_command([" ".join(arguments.words)])
    lines.append(f"{len(shown)} of {len(found)} lenses; the first one serves as --camera {name}")
    return print_result(arguments, rows, lines)


def _add_convert(actions: Any) -> None:
    convert = actions.add_parser(
        "convert",
        help="fit one lens model by another",
        description="Fits a lens of MODEL to the lens in LENS over its whole image, prints the "
        "worst error by field angle, and writes the result.",
    )
    convert.add_argument("lens", metavar="LENS", help="lens file")
    convert.add_argument("model", metavar="MODEL", help="model to fit, such as opencv8")
    convert.add_argument(
        "-o", "--out", metavar="FILE", help="lens file to write; see gsut.save_camera"
    )
    convert.add_argument("--camera-id", metavar="ID", help="which camera of LENS")
    convert.add_argument(
        "--max-angle",
        type=Number(0, 180, above=True),
        metavar="DEGREES",
        help="leave out what is farther from the axis [default: the whole image]",
    )
    add_json(convert)
    convert.set_defaults(action=_convert)


def _convert(arguments: argparse.Namespace) -> int:
    from gsut.lens import convert_camera, load_camera, save_camera

    if arguments.out is not None:
        refuse_existing(Path(arguments.out), " with -o")
    camera = load_camera(arguments.lens, camera_id=arguments.camera_id)
    limit = None if arguments.max_angle is None else math.radians(arguments.max_angle)
    conversion = convert_camera(camera, arguments.model, limit)
    if arguments.out is not None:
        save_camera(conversion.camera, arguments.out)
    lens = conversion.camera
    figures = {
        "model": lens.model, "params": list(map(float, lens.params)),
        "width": lens.width, "height": lens.height,
        "rms": conversion.rms, "worst": conversion.worst,
        "rings": [dataclasses.asdict(ring) for ring in conversion.rings],
    }  # fmt: skip
    lines = [f"{camera.model} -> {lens.model}, {camera.width} x {camera.height}"]
    lines.append(conversion.format_rings())
    if arguments.out is not None:
        lines.append(f"wrote {arguments.out}")
    return print_result(arguments, figures, lines)
