"""`gsut demo`: makes a small fisheye scene with known truth, trains on it, shows the report."""

from __future__ import annotations

import argparse
import sys
import webbrowser
from pathlib import Path
from typing import Any

import numpy as np

from gsut.cli._flags import add_json, print_json, read_folder_name, whole
from gsut.cli.train import print_figures, train_into
from gsut.cli.view import has_display
from gsut.run import RunFile, RunFolder, TrainOptions, Verdict

HELP = "make a small fisheye scene, train on it, show the report"
DESCRIPTION = (
    "Makes a small fisheye scene with known truth, trains on it and opens the report. Uses nothing "
    "but this machine."
)
# Of each camera, so that all have 40 images.
_FRAMES = {2: 20, 4: 10}


def add_flags(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "-o",
        "--out",
        type=read_folder_name,
        metavar="FOLDER",
        default="demo",
        help="folder for all of it [default demo]",
    )
    parser.add_argument(
        "--steps", type=whole, metavar="N", default=1000, help="training steps [default 1000]"
    )
    parser.add_argument(
        "--rig",
        nargs="?",
        type=whole,
        const=2,
        choices=(2, 4),
        help="two fisheyes on one body instead, or four of 220 degrees with OCamCalib's files: "
        "finds their poses with `gsut poses --rig`, trains on them, and prints the errors of "
        "poses, scale and depth against the truth",
    )
    parser.add_argument(
        "--no-open", action="store_true", help="do not open the report in a browser"
    )
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
    from gsut.demo import make_demo_scene

    options = TrainOptions(preset="fast", steps=arguments.steps)
    folder = Path(arguments.out)
    poses: dict[str, Any] = {}
    name = {None: "", 2: "rig_", 4: "surround_"}[arguments.rig]
    if arguments.rig:
        data, truth = folder / f"{name}poses", folder / f"{name}hall"
        poses = {"poses": _find_rig_poses(truth, data, arguments.rig)}
    else:
        data = folder / "fisheye_hall"
        if not data.is_dir():
            print(f"making a fisheye scene in {data}", file=sys.stderr)
            make_demo_scene(data)
    run, resume = _free_run(folder, options, f"{name}run")
    metrics = train_into(run, str(data), options, resume, quiet=False)
    if arguments.rig:
        poses["depth"] = _measure_depth_errors(run, truth / "depth")
    report = run.path / RunFile.REPORT
    if arguments.json:
        print_json(metrics | poses)
    else:
        if poses:
            print(_describe_poses(poses["poses"], data))
            print(_describe_depth(poses["depth"]))
        print_figures(metrics)
        print(Verdict.from_dict(metrics["verdict"]))
        print(f"report: {report}")
    if not arguments.no_open and has_display():
        webbrowser.open(report.resolve().as_uri())
    return 0


def _find_rig_poses(truth: Path, found: Path, cameras: int) -> dict[str, Any]:
    """Makes the demo's rig and finds its poses; returns their errors."""
    from gsut.cli.poses import find_with_bar
    from gsut.demo import make_demo_rig
    from gsut.sfm import compare_datasets, is_finished

    if not truth.is_dir():
        print(f"making a scene of {cameras} fisheyes on one body in {truth}", file=sys.stderr)
        make_demo_rig(truth, _FRAMES[cameras], cameras=cameras)
    if not is_finished(found):
        find_with_bar(truth / "images", found, True, rig=truth / "rig.json")
    errors = compare_datasets(truth, found)
    return {
        "images": errors.images,
        "scale_error_percent": errors.scale_error_percent,
        "metric_ate": errors.metric_ate,
        "extent": errors.extent,
        "rotation_median_degrees": float(np.median(errors.rotation_degrees)),
    }


def _measure_depth_errors(run: RunFolder, truth: Path) -> dict[str, Any]:
    """Measures the held-out views' median depths; distances along rays need no common frame."""
    from gsut.surface import judge_geometry
    from gsut.training import read_trained

    options, scene, gaussians = read_trained(run, None)
    figures = judge_geometry(
        gaussians, scene, scene.test_indices, truth, background=options.background
    )
    return figures["depth"]["median"]


def _describe_depth(figures: dict[str, Any]) -> str:
    edge = figures["rings"][-1]
    rim = "" if edge["abs_rel_median"] is None else f", {100 * edge['abs_rel_median']:.2f} % "
    return (
        "depth of the held-out images against the truth: off by "
        f"{100 * figures['abs_rel_median']:.2f} % of the distance (median){rim}"
        + (f"from {edge['from_degrees']:g} degrees off-axis" if rim else "")
    )


def _describe_poses(errors: dict[str, Any], found: Path) -> str:
    return (
        f"poses of {errors['images']} images against the truth: lengths off by "
        f"{errors['scale_error_percent']:+.2f} %, centres by {errors['metric_ate']:.4f} m of "
        f"{errors['extent']:.1f} m (rms), turns by {errors['rotation_median_degrees']:.3f} degrees "
        f"(median); report: {found / RunFile.REPORT}"
    )


def _free_run(folder: Path, options: TrainOptions, name: str = "run") -> tuple[RunFolder, bool]:
    """Finds the first of NAME, NAME-2 ... that is free, or unfinished with the same options."""
    number = 1
    while True:
        run = RunFolder(folder / (name if number == 1 else f"{name}-{number}"))
        if not run.has_run():
            return run, False
        unfinished = (
            not (run.path / RunFile.REPORT).is_file() and (run.path / RunFile.OPTIONS).is_file()
        )
        if unfinished and run.read_options() == options:
            return run, True
        number += 1
