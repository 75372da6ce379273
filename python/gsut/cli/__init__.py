"""The command line: `gsut train`, `eval`, `render`, `calibrate`, `camera`, `demo`, `doctor` ...

Everything that takes long to import is imported by the command that needs it, so that `--help` and
a wrong argument answer at once.
"""

from __future__ import annotations

import argparse
import os
import sys
import traceback
from collections.abc import Sequence
from typing import Any, NoReturn

from gsut import _core
from gsut.bench.arguments import add_bench
from gsut.run import TrainOptions, add_option_flags

EXIT_OK = 0
EXIT_INPUT = 2  # wrong arguments or data: one sentence says which
EXIT_INTERRUPTED = 130  # as shells report Ctrl-C
DEBUG_VARIABLE = "GSUT_DEBUG"


class _Parser(argparse.ArgumentParser):
    """An argument parser whose errors are one sentence, like all others.

    Flags cannot be shortened: a new flag would change what an old command line means.
    """

    def __init__(self, **settings: Any) -> None:
        super().__init__(allow_abbrev=False, **settings)

    def error(self, message: str) -> NoReturn:
        raise _core.InputError(f"{message} (see {self.prog} --help)")


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs one command; returns its exit status.

    Args:
        arguments: the words after the program's name; those of the process if None.

    Returns:
        0; 2 after wrong input, told in one sentence on standard error (with GSUT_DEBUG=1 the
        traceback too); 130 after Ctrl-C.
    """
    try:
        parsed = build_parser().parse_args(arguments)
        return parsed.run(parsed)
    except KeyboardInterrupt as interrupt:
        print(f"\ngsut: {interrupt or 'stopped'}", file=sys.stderr)
        return EXIT_INTERRUPTED
    except BrokenPipeError:  # the reader of a pipe, such as head, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_OK
    except (_core.InputError, _core.CalibrationError, _core.SolveError) as error:
        return _report(str(error))
    except OSError as error:
        if error.filename is None:
            raise
        return _report(f"{error.filename}: {error.strerror}")


def _report(message: str) -> int:
    if os.environ.get(DEBUG_VARIABLE, "0") not in ("", "0"):
        traceback.print_exc()
    print(f"gsut: error: {' '.join(message.split())}", file=sys.stderr)
    return EXIT_INPUT


def build_parser() -> argparse.ArgumentParser:
    """The parser of all commands; each sets `run`, the function that carries it out."""
    parser = _Parser(
        prog="gsut",
        description="3D Gaussian splatting for any real lens, on any machine, without a GPU.",
        epilog="`gsut COMMAND --help` lists a command's options.",
    )
    parser.add_argument("--version", action="version", version=f"gsut {_core.__version__}")
    commands = parser.add_subparsers(
        title="commands", metavar="COMMAND", required=True, parser_class=_Parser
    )
    _add_train(commands)
    _add_eval(commands)
    _add_render(commands)
    _add_calibrate(commands)
    _add_compact(commands)
    _add_localize(commands)
    _add_poses(commands)
    _add_demo(commands)
    _add_doctor(commands)
    _add_camera(commands)
    add_bench(commands, _Parser)
    return parser


def _command(name: str):
    """A command's function out of gsut.commands, which is imported only when it is called."""

    def run(arguments: argparse.Namespace) -> int:
        from gsut.cli import commands

        return getattr(commands, name)(arguments)

    return run


def _add_train(commands) -> None:
    parser = commands.add_parser(
        "train",
        help="train a scene on photographs",
        description="Trains a scene on photographs and writes scene.ply, metrics.json, report.html "
        "and a checkpoint to RUN.",
    )
    parser.add_argument(
        "data",
        metavar="DATA",
        help="COLMAP or nerfstudio dataset, or a folder of images with a lens file and poses",
    )
    parser.add_argument("-o", "--out", metavar="RUN", required=True, help="folder of the run")
    parser.add_argument(
        "--resume",
        action="store_true",
        help="go on with the run in RUN from its last checkpoint, with its own options; the result "
        "has the same bits as an unbroken run",
    )
    parser.add_argument("--quiet", action="store_true", help="no progress bar, no summary")
    parser.add_argument(
        "--json", action="store_true", help="print metrics.json instead of the summary"
    )
    add_option_flags(parser, TrainOptions)
    parser.set_defaults(run=_command("train"))


def _add_eval(commands) -> None:
    parser = commands.add_parser(
        "eval",
        help="figures on the held-out images",
        description="Renders the held-out views of a run's dataset and prints PSNR, SSIM and the "
        "PSNR by field angle. Changes nothing in RUN.",
    )
    parser.add_argument("folder", metavar="RUN", help="folder of the run")
    parser.add_argument(
        "--data", metavar="DATA", help="the dataset, if it is not where training read it"
    )
    parser.add_argument(
        "--split",
        choices=("test", "train", "all"),
        default="test",
        help="which views [default test: the held-out ones]",
    )
    parser.add_argument(
        "-o",
        "--out",
        metavar="FOLDER",
        help="new folder for the pictures (truth, render, 16-bit distance) and metrics.json",
    )
    parser.add_argument("--json", action="store_true", help="print all figures as JSON")
    parser.set_defaults(run=_command("evaluate"))


def _add_render(commands) -> None:
    parser = commands.add_parser(
        "render",
        help="images or a video through any lens along any path",
        description="Renders a run's scene through any lens along a camera path.",
    )
    parser.add_argument("folder", metavar="RUN", help="folder of the run")
    parser.add_argument(
        "--data", metavar="DATA", help="the dataset, if it is not where training read it"
    )
    parser.add_argument(
        "--camera", metavar="LENS", help="lens file [default: the dataset's first camera]"
    )
    parser.add_argument(
        "--size", metavar="WxH", help="size of the images in pixels; the lens is scaled to it"
    )
    parser.add_argument(
        "--low-pass",
        type=float,
        default=0.0,
        metavar="PIXELS",
        help="widen what is below a pixel of each image: standard deviation of a 3D filter; 0.3 "
        "against the aliasing of distant views and small images [default 0: none]",
    )
    parser.add_argument(
        "--path",
        default="orbit",
        metavar="{orbit,test,train,FILE}",
        help="orbit: once around the scene; train: smoothly through the training poses; test: "
        "exactly the held-out poses; FILE: JSON with camera_from_world (4x4 matrices, OpenCV axes) "
        "or a nerfstudio camera path or transforms.json [default orbit]",
    )
    parser.add_argument(
        "--frames",
        type=int,
        default=120,
        metavar="N",
        help="number of images of orbit and train [default 120]",
    )
    parser.add_argument(
        "--fps",
        type=float,
        default=30.0,
        metavar="X",
        help="images a second of a video [default 30]",
    )
    parser.add_argument(
        "-o",
        "--out",
        metavar="FOLDER|FILE.mp4",
        help="new folder of PNG images, or video [default: RUN/orbit and so on]",
    )
    parser.set_defaults(run=_command("render"))


def _add_calibrate(commands) -> None:
    from gsut.cli.calibrate import add_calibrate_flags, calibrate

    parser = commands.add_parser(
        "calibrate",
        help="photographs of a chessboard to a lens file",
        description="Finds the board in photographs, solves for the lens with OpenCV or mrcal, and "
        "writes a lens file with the field angle to which it can be trusted, and a report.",
    )
    add_calibrate_flags(parser)
    parser.set_defaults(run=calibrate)


def _add_compact(commands) -> None:
    from gsut.cli.compact_command import add_compact_flags, compact_command

    parser = commands.add_parser(
        "compact",
        help="fewer Gaussians for the same picture",
        description="Merges or prunes the Gaussians of a finished run, or of a PLY file, and "
        "writes a new run or file. Nothing in RUN changes.",
    )
    add_compact_flags(parser)
    parser.set_defaults(run=compact_command)


def _add_localize(commands) -> None:
    from gsut.cli.localize_command import add_localize_flags, localize

    parser = commands.add_parser(
        "localize",
        help="where a photograph of a trained scene was taken",
        description="Finds the pose of a photograph: matches its features with views rendered from "
        "the training poses that look most like it, and refines the pose by the colours.",
    )
    add_localize_flags(parser)
    parser.set_defaults(run=localize)


def _add_poses(commands) -> None:
    from gsut.cli.poses_command import add_poses_flags, poses

    parser = commands.add_parser(
        "poses",
        help="camera poses and points of photographs, without COLMAP",
        description="Finds where photographs were taken, through any lens, and points that they "
        "see; writes a dataset that `gsut train` reads.",
    )
    add_poses_flags(parser)
    parser.set_defaults(run=poses)


def _add_demo(commands) -> None:
    parser = commands.add_parser(
        "demo",
        help="make a small fisheye scene, train on it, show the report",
        description="Makes a small fisheye scene with known truth, trains on it and opens the "
        "report. Uses nothing but this machine.",
    )
    parser.add_argument(
        "-o", "--out", metavar="FOLDER", default="demo", help="folder for all of it [default demo]"
    )
    parser.add_argument(
        "--steps", type=int, metavar="N", default=1000, help="training steps [default 1000]"
    )
    parser.add_argument(
        "--rig",
        action="store_true",
        help="two fisheyes on one body instead: finds their poses with `gsut poses --rig`, tells "
        "their errors against the truth, the scale's too, and trains on them",
    )
    parser.add_argument(
        "--no-open", action="store_true", help="do not open the report in a browser"
    )
    parser.set_defaults(run=_command("demo"))


def _add_doctor(commands) -> None:
    parser = commands.add_parser(
        "doctor",
        help="what is wrong with a dataset, in words",
        description="Looks for everything in a dataset that would stop or spoil training. The exit "
        "status is 2 if training cannot start.",
    )
    parser.add_argument("data", metavar="DATA", help="the dataset")
    parser.set_defaults(run=_command("doctor"))


def _add_camera(commands) -> None:
    parser = commands.add_parser(
        "camera", help="convert a lens into another model", description="Works on lens files."
    )
    actions = parser.add_subparsers(metavar="ACTION", required=True, parser_class=_Parser)
    convert = actions.add_parser(
        "convert",
        help="fit one lens model by another",
        description="Fits a lens of MODEL to the lens in LENS over its whole image, prints the "
        "worst error by field angle, and writes the result.",
    )
    convert.add_argument("lens", metavar="LENS", help="lens file")
    convert.add_argument("model", metavar="MODEL", help="model to fit, such as opencv8")
    convert.add_argument("-o", "--out", metavar="FILE", help="lens file to write; see Camera.save")
    convert.add_argument("--camera-id", metavar="ID", help="which camera of LENS")
    convert.add_argument(
        "--max-angle",
        type=float,
        metavar="DEGREES",
        help="leave out what is farther from the axis [default: the whole image]",
    )
    convert.add_argument(
        "--num-params",
        type=int,
        metavar="N",
        help="of a lens with any number of coefficients [default: four coefficients]",
    )
    convert.add_argument(
        "--order", type=int, metavar="2|3", help="of splined_stereographic [default: 3]"
    )
    convert.add_argument(
        "--control-points",
        type=int,
        nargs="+",
        metavar="N",
        help="of splined_stereographic: NX, or NX NY [default: 16, NY at the same pitch]",
    )
    convert.add_argument(
        "--distance",
        type=float,
        metavar="UNITS",
        help="where both lenses are to agree, if the rays of one do not meet [default: far away]",
    )

    def run(arguments: argparse.Namespace) -> int:
        from gsut.lens import run_convert

        return run_convert(arguments)

    convert.set_defaults(run=run)
