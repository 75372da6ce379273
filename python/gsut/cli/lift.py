"""`gsut lift`: labels or other numbers of pixels become a property of a scene's Gaussians."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.cli._flags import (
    add_json,
    print_result,
    show_findings,
    whole,
)
from gsut.files import refuse_existing

HELP = "put labels or other numbers of pixels onto the Gaussians, without training"
DESCRIPTION = (
    "Gives each Gaussian the mean of what the training views' pixels that see it say: labels, "
    "descriptors, temperatures. `gsut render RUN --lifted FILE.npz` shows them from anywhere. "
    "Where held-out views have maps too, prints how well they are met."
)


def add_flags(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("data", metavar="DATA", help="the dataset")
    parser.add_argument(
        "folder", metavar="RUN", help="a finished run of it, or a file of Gaussians"
    )
    parser.add_argument(
        "maps",
        metavar="MAPS",
        help="folder of a file a view, named like its image and of its size: .npy of one or more "
        "numbers a pixel, or .png, .tif of 8 or 16 bits",
    )
    parser.add_argument(
        "-o", "--out", metavar="FILE.npz", required=True, help="new file of what was lifted"
    )
    parser.add_argument(
        "--labels",
        action="store_true",
        help="the numbers are names of things: Gaussians and pixels get that of most of the weight",
    )
    parser.add_argument(
        "--unknown", type=whole, metavar="N", help="a label that says nothing, such as 255"
    )
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
    from gsut.lifting import Lifted, MapFolder, judge_lifted, lift
    from gsut.run import Progress

    if arguments.unknown is not None and not arguments.labels:
        raise InputError(
            "--unknown is a label; add --labels, or mark unknown numbers by NaN (.npy)"
        )
    out = Lifted.check_name(arguments.out)
    refuse_existing(out, " with -o")
    scene, gaussians = _open_scene(arguments)
    maps = MapFolder(Path(arguments.maps), scene)
    options = {"labels": arguments.labels, "unknown": arguments.unknown}
    with Progress(not arguments.json) as bars:

        def show_view(done: int, total: int) -> None:
            bars.show("views", done, total)

        lifted = lift(gaussians, scene, maps, on_view=show_view, **options)
        judged = judge_lifted(lifted, gaussians, scene, maps, unknown=arguments.unknown)
    lifted.save(out)
    seen = float(np.mean(lifted.weights > 0))
    width = lifted.features.shape[1]
    figures = {
        "gaussians": len(gaussians), "seen": seen, "maps": len(maps),
        "labels" if arguments.labels else "values": width, **judged, "out": str(out),
    }  # fmt: skip
    lines = [
        f"{width} {'labels' if arguments.labels else 'values a pixel'} on {seen:.1%} of "
        f"{len(gaussians):,} Gaussians: {out}"
    ]
    if "right" in judged:
        lines.append(f"right on {judged['right']:.2%} of {judged['pixels']:,} held-out pixels")
    elif judged:
        lines.append(f"off by {judged['rms']:.4g} (rms) on {judged['pixels']:,} held-out pixels")
    return print_result(arguments, figures, lines)


def _open_scene(arguments: argparse.Namespace) -> tuple[Any, Any]:
    """Reads the dataset as the run saw it, and the Gaussians in the order of their file."""
    import gsut
    from gsut.run import RunFile, RunFolder
    from gsut.training import read_scene

    place = Path(arguments.folder)
    if not place.exists():
        raise InputError(f"{place}: no such file or folder; give a run or a file of Gaussians")
    if place.is_file():
        scene = gsut.load_dataset(arguments.data)
        show_findings(scene, None)
        return scene, gsut.load_gaussians(place)
    run = RunFolder.open(place)
    _, scene = read_scene(run, arguments.data)
    show_findings(scene, run)
    return scene, gsut.load_gaussians(run.path / RunFile.SCENE)
