"""`gsut eval`: the figures of a finished run on its held-out images."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from gsut._core import InputError
from gsut.cli._flags import (
    add_force,
    add_json,
    add_run,
    check_first,
    folder_name,
    print_json,
)

HELP = "figures on the held-out images"
DESCRIPTION = (
    "Renders the held-out views of a run's dataset and prints PSNR, SSIM and the PSNR by field "
    "angle. Changes nothing in RUN."
)


def add_flags(parser: argparse.ArgumentParser) -> None:
    add_run(parser)
    parser.add_argument(
        "--split",
        choices=("test", "train", "all"),
        default="test",
        help="which views [default test: the held-out ones]",
    )
    parser.add_argument(
        "-o",
        "--out",
        type=folder_name,
        metavar="FOLDER",
        help="new folder for the pictures (truth, render, 16-bit distance) and metrics.json",
    )
    add_force(parser)
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
    from gsut.cli.render import new_folder
    from gsut.cli.train import print_figures
    from gsut.evaluate import evaluate
    from gsut.run import METRICS, Progress, RunFolder
    from gsut.training import read_light, read_trained

    run = RunFolder.open(arguments.folder)
    options, scene, gaussians = read_trained(run, arguments.data)
    indices = {
        "test": scene.test_indices,
        "train": scene.train_indices,
        "all": list(range(len(scene.views))),
    }[arguments.split]
    if not indices:
        raise InputError(
            f"{scene.path} has no {arguments.split} views with these options; try --split all"
        )
    out = new_folder(Path(arguments.out)) if arguments.out else None
    check_first(scene, arguments.force, quiet=True)
    with Progress(sys.stderr.isatty()) as bars:
        figures = evaluate(
            gaussians,
            scene,
            indices,
            background=options.background,
            light=read_light(run, scene),
            render_folder=out,
            on_view=lambda done, total: bars.show("views", done, total),
        )
    figures["num_gaussians"] = len(gaussians)
    if options.refine_poses:
        print("gsut: note: poses as the run refined them, held-out views aligned", file=sys.stderr)
    if out is not None:
        RunFolder(out).write_json(METRICS, figures)
    if arguments.json:
        print_json(figures)
    else:
        for row in figures["views"]:
            print(f"{row['psnr']:7.2f} dB  SSIM {row['ssim']:.4f}  {row['name']}")
        print_figures(figures)
    return 0
