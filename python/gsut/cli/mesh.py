"""`gsut mesh`: the surface of a trained scene as a mesh."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from gsut.cli._flags import (
    Number,
    add_json,
    add_quiet,
    add_run,
    finite,
    positive,
    print_result,
    show_findings,
)
from gsut.files import refuse_existing

HELP = "the surface as a mesh"
DESCRIPTION = (
    "Makes a mesh of a trained scene: each training view's depth is rendered through its own lens, "
    "kept where neighbouring views agree, and fused into a distance field whose surface is written "
    "with colours and normals, in the dataset's coordinates. Memory: 20 bytes a pixel of all depth "
    "maps (40 with --refine) and 2.3 kB a block of 8 x 8 x 8 voxels near the surface, "
    "2.3 GB at most."
)


def add_flags(parser: argparse.ArgumentParser) -> None:
    add_run(parser)
    parser.add_argument(
        *("-o", "--out"),
        metavar="FILE",
        required=True,
        help="mesh to write: .ply, .obj or .glb",
    )
    parser.add_argument(
        "--voxel",
        type=positive,
        metavar="SIZE",
        help="in the dataset's units [default: a pixel's width at the median depth, at least a "
        "1024th of the scene]",
    )
    parser.add_argument(
        "--photographs",
        action="store_true",
        help="colours from the photographs in place of the renders",
    )
    parser.add_argument(
        "--crop",
        type=finite,
        nargs=6,
        metavar=("X0", "Y0", "Z0", "X1", "Y1", "Z1"),
        help="box in the dataset's coordinates outside of which nothing stays",
    )
    parser.add_argument(
        "--refine", action="store_true",
        help="move each depth to where windows of the photographs correlate best, and again from "
        "the mesh that these give",
    )  # fmt: skip
    parser.add_argument(
        "--support", type=Number(0, 8, whole=True), default=2, metavar="N",
        help="other views, of the 8 nearest, that must agree with a depth to 1 %% [default 2; 0: "
        "no check]",
    )  # fmt: skip
    parser.add_argument(
        "--holes", type=Number(0, whole=True), default=0, metavar="N",
        help="close holes of up to N edges [default 0: none]",
    )  # fmt: skip
    add_quiet(parser)
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
    from gsut.run import Progress, RunFolder
    from gsut.surface import MeshOptions, check_mesh_name, extract_mesh, save_mesh
    from gsut.training import open_trained

    out = Path(arguments.out)
    check_mesh_name(out)
    refuse_existing(out)
    began = time.perf_counter()
    run = RunFolder.open(arguments.folder)
    options, scene, gaussians = open_trained(run, None)
    show_findings(scene, run, arguments.quiet)
    settings = MeshOptions(
        voxel=arguments.voxel,
        support=arguments.support,
        refine=arguments.refine,
        photographs=arguments.photographs,
        holes=arguments.holes,
        crop=None if arguments.crop is None else np.array(arguments.crop),
    )
    with Progress(not arguments.quiet) as bars:
        mesh = extract_mesh(
            gaussians, scene, settings, background=options.background, progress=bars.show
        )
    save_mesh(out, mesh)
    figures = {
        "vertices": len(mesh.vertices), "faces": len(mesh.faces),
        "seconds": time.perf_counter() - began, "out": str(out),
    }  # fmt: skip
    return print_result(arguments, figures, [f"{out}: {mesh}, {figures['seconds']:.1f} s"])
