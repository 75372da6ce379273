"""`gsut demo`: trains on a small fisheye scene with known truth and shows the report."""

from __future__ import annotations

import argparse
import sys
import webbrowser
from pathlib import Path
from typing import Any

import numpy as np

from gsut.cli._flags import add_json, print_result, read_folder_name, whole
from gsut.cli.train import summarize, train_into
from gsut.cli.view import has_display
from gsut.run import RunFile, RunFolder, TrainOptions

HELP = "train on a small fisheye scene, show the report"
DESCRIPTION = (
    "Trains on a small fisheye scene with known truth, which comes with gsut, and opens the "
    "report. Uses nothing but this machine."
)


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
        action="store_true",
        help="two fisheyes on one body instead: finds their poses with `gsut poses --rig`, trains "
        "on them, and prints the errors of poses, scale and depth against the truth",
    )
    parser.add_argument(
        "--no-open", action="store_true", help="do not open the report in a browser"
    )
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
    from gsut.demo import write_demo_scene

    options = TrainOptions(preset="fast", steps=arguments.steps)
    folder = Path(arguments.out)
    made = folder / ("rig_hall" if arguments.rig else "fisheye_hall")
    if not made.is_dir():
        print(f"writing the demo's scene to {made}", file=sys.stderr)
        write_demo_scene(made, made.name)
    data = folder / "rig_poses" if arguments.rig else made
    poses: dict[str, Any] = {"poses": _find_rig_poses(made, data)} if arguments.rig else {}
    run, resume = _free_run(folder, options, "rig_run" if arguments.rig else "run")
    metrics = train_into(run, str(data), options, resume, quiet=False)
    if arguments.rig:
        poses["depth"] = _measure_depth_errors(run, made / "depth")
    report = run.path / RunFile.REPORT
    lines = []
    if poses:
        lines.append(_describe_poses(poses["poses"], data))
        if poses["depth"] is not None:
            lines.append(_describe_depth(poses["depth"]))
    print_result(arguments, metrics | poses, [*lines, *summarize(metrics, run)])
    if not arguments.no_open and has_display():
        webbrowser.open(report.resolve().as_uri())
    return 0


def _find_rig_poses(truth: Path, found: Path) -> dict[str, Any]:
    """Finds the poses of the demo's rig; returns their errors."""
    from gsut.cli.poses import find_with_bar
    from gsut.data.rigs import read_rig
    from gsut.sfm import compare_datasets, is_finished

    if not is_finished(found):
        rig = read_rig(truth / "rig.json")
        find_with_bar(truth / "images", found, True, camera=rig)
    errors = compare_datasets(truth, found)
    return {
        "images": errors.images,
        "scale_error_percent": errors.scale_error_percent,
        "metric_ate": errors.metric_ate,
        "extent": errors.extent,
        "rotation_median_degrees": float(np.median(errors.rotation_degrees)),
    }


def _measure_depth_errors(run: RunFolder, truth: Path) -> dict[str, Any] | None:
    """Measures the held-out views' median depths; distances along rays need no common frame.

    Returns None if other views are held out than those whose depth comes with the scene.
    """
    from gsut.surface import judge_geometry
    from gsut.training import read_trained

    options, scene, gaussians = read_trained(run, None)
    photographs = [scene.views[index].image_path for index in scene.test_indices]
    if not all((truth / path.parent.name / path.name).is_file() for path in photographs):
        return None
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
