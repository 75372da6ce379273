"""`gsut calibrate`: has calib/ solve for a lens from photographs of a board."""

from __future__ import annotations

import argparse
import glob
import importlib
import os
import sys
from pathlib import Path
from types import ModuleType

from gsut._core import InputError
from gsut.cli._flags import add_json, add_quiet, finite, print_result
from gsut.files import ENDINGS, check_regular, read_json
from gsut.output_folder import claim_folder
from gsut.terminal import say

HELP = "photographs of a chessboard to a lens file"
DESCRIPTION = (
    "Finds the board in photographs, solves for the lens with OpenCV or mrcal, and writes a lens "
    "file with the field angle to which it can be trusted, and a report."
)
_HERE = Path(__file__).resolve().parent
# The folder that holds calib/: of an installed gsut, or of the repository.
_PLACES = (_HERE.parent / "share", _HERE.parents[2])
_LENSES = ("auto", "fisheye", "opencv4", "opencv8", "splined")
_REPORT = "report.json"  # beside the lens file
_SOLVERS = ("auto", "opencv", "mrcal")
_MRCAL_INSTALL = "sudo apt-get install mrcal python3-mrcal"  # as in calib/solve/mrcal_process.py


def add_flags(parser: argparse.ArgumentParser) -> None:
    parser.epilog = (
        "mrcal is a program of the system, not part of gsut, and optional: it solves opencv4, "
        "opencv8 and splined lenses, states their uncertainty, and solves all cameras of a rig at "
        f"once. Install it with `{_MRCAL_INSTALL}`; without it OpenCV solves fisheye, opencv4 and "
        "opencv8."
    )
    parser.add_argument(
        "images", metavar="IMAGES", nargs="*", help="photographs of the board, or folders of them"
    )
    parser.add_argument(
        "--board",
        metavar="COLUMNSxROWS",
        help="inner corners of the chessboard, where four squares meet, such as 9x6",
    )
    parser.add_argument(
        "--spacing",
        metavar="METRES",
        type=finite,
        help="side of a square, in metres (or any unit: the poses of a rig then have it)",
    )
    parser.add_argument(
        "--lens",
        choices=_LENSES,
        default="auto",
        help="auto: the one that predicts boards it has not seen best; fisheye: Kannala-Brandt "
        "with 4 coefficients; opencv4, opencv8: radial-tangential; splined: mrcal's splined "
        "stereographic [default auto]",
    )
    parser.add_argument(
        "--solver",
        choices=_SOLVERS,
        default="auto",
        help="auto: OpenCV for fisheye, mrcal for the others; --lens auto does without mrcal where "
        "it is not installed [default auto]",
    )
    parser.add_argument(
        "--rig",
        metavar="NAMES",
        default="",
        help="names of a rig's cameras with commas, such as left,right: each image's path holds "
        "one of them, and images whose paths are otherwise the same were taken together",
    )
    parser.add_argument(
        "-o",
        "--out",
        metavar="LENS",
        required=True,
        help="lens file, .cameramodel (mrcal) or .yaml (OpenCV); a rig's cameras get LENS-NAME; "
        "report.html, report.json, corners.vnl and the folder corners are written beside it, and "
        "replace older ones",
    )
    add_quiet(parser)
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
    out = Path(arguments.out)
    writes = (out.name, _REPORT, "report.html", "corners", "corners.vnl")
    with claim_folder(out.parent, "calibrate", writes=writes):
        lines = _calibrate(arguments)
    return print_result(arguments, read_json(out.parent / _REPORT), lines)


def _calibrate(arguments: argparse.Namespace) -> list[str]:
    """Runs calib on the arguments; returns the lines of its summary.

    Raises:
        InputError: a flag or image is missing, the photographs do not serve, or calib/ is not
            installed.
    """
    for name in ("images", "board", "spacing"):
        if getattr(arguments, name) in ([], None):
            what = "photographs" if name == "images" else f"--{name}"
            raise InputError(
                f"{what} missing: give photographs of a chessboard with --board COLUMNSxROWS and "
                "--spacing METRES. Without a board `gsut poses --unknown-lens` finds the lens"
            )
    calib = _import_calib()
    job = calib.Job(
        images=tuple(_list_images(arguments.images)),
        board=arguments.board,
        spacing=arguments.spacing,
        out=Path(arguments.out),
        lens=arguments.lens,
        solver=arguments.solver,
        cameras=tuple(name.strip() for name in arguments.rig.split(",") if name.strip()),
        progress=not arguments.quiet,
    )
    result = calib.calibrate(job)
    for note in result.notes:
        say(f"note: {note}")
    return result.summarize()


def _import_calib() -> ModuleType:
    """Imports calib/, which lies beside gsut and uses its public names only.

    Raises:
        InputError: calib/ is not installed.
    """
    place = next((place for place in _PLACES if (place / "calib" / "__init__.py").is_file()), None)
    if place is None:
        raise InputError(
            "calib/ is not part of this installation; run gsut from a clone of its repository"
        )
    if str(place) not in sys.path:
        sys.path.insert(0, str(place))
    return importlib.import_module("calib")


def _list_images(given: list[str]) -> list[Path]:
    """Lists files; folders and quoted patterns are replaced by the images in them."""
    found: list[Path] = []
    for name in given:
        path = Path(name)
        if path.is_dir():
            inside = [p for p in sorted(path.iterdir()) if p.suffix.lower() in ENDINGS["picture"]]
            if not inside:
                raise InputError(f"{path} holds no images ({', '.join(ENDINGS['picture'])})")
            found += inside
        elif not path.exists() and glob.has_magic(name):
            matches = sorted(glob.glob(name))
            if not matches:
                raise InputError(f"no file matches {name}; check the path")
            found += [Path(match) for match in matches]
        else:
            if os.path.lexists(path) and not path.is_file():
                check_regular(path)  # a pipe, a link to itself: said so
            found.append(path)
    return found
