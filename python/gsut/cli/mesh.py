"""`gsut mesh`: the surface of a trained scene as a mesh, or the space around it as a grid."""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.cli._flags import (
    Number,
    add_json,
    add_quiet,
    add_run,
    count,
    finite,
    positive,
    print_json,
    show_findings,
)
from gsut.files import refuse_existing, write_file

HELP = "the surface as a mesh, or a grid of distances or of what is occupied"
DESCRIPTION = (
    "Makes a mesh of a trained scene: each training view's depth is rendered through its own lens, "
    "kept where neighbouring views agree, and fused into a distance field whose surface is written "
    "with colours and normals, in the dataset's coordinates. Memory: 20 bytes a pixel of all depth "
    "maps (40 with --refine) and 2.3 kB a block of 8 x 8 x 8 voxels near the surface, "
    "2.3 GB at most. To a .npy goes a dense grid instead: each voxel's distance to the surface, "
    "negative behind it, NaN where no view says anything; FILE.json beside it says where the "
    "voxels are."
)


def add_flags(parser: argparse.ArgumentParser) -> None:
    add_run(parser)
    parser.add_argument(
        *("-o", "--out"),
        metavar="FILE",
        required=True,
        help="mesh to write: .ply, .off, .obj or .glb; or grid: .npy",
    )
    parser.add_argument(
        "--occupancy", action="store_true",
        help="of a grid: 100 occupied, 0 free, -1 unknown (int8), in place of distances",
    )  # fmt: skip
    parser.add_argument(
        "--triangles", action="store_true",
        help="of a run with --primitive triangle: the triangles themselves in place of the "
        "surface, opaque where each hides half of what lies behind it",
    )  # fmt: skip
    parser.add_argument(
        "--voxel",
        type=positive,
        metavar="SIZE",
        help="in the dataset's units [default: a pixel's width at the median depth, at least a "
        "1024th of the scene; of a grid a 128th of its longest side]",
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
        "--faces", type=count, metavar="N", help="reduce to about N faces (needs gsut[mesh])"
    )
    parser.add_argument(
        "--fit", type=Number(0, whole=True), metavar="N",
        help="fit the mesh to the images as engines draw it, without blending: colours by least "
        "squares and, in N rounds, vertices along their normals; 0: colours only",
    )  # fmt: skip
    _add_pages(parser)
    add_quiet(parser)
    add_json(parser)
    _add_fusion(parser)


def _add_fusion(parser: argparse.ArgumentParser) -> None:
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
        "--max-side", type=count, default=1024, metavar="PIXELS",
        help="longer side of the depth maps [default 1024]",
    )  # fmt: skip
    parser.add_argument(
        "--holes", type=Number(0, whole=True), default=0, metavar="N",
        help="close holes of up to N edges [default 0: none]",
    )  # fmt: skip


def _add_pages(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--report", metavar="FILE.html",
        help="also a page with the mesh and the depths as some of the photographs' views see them",
    )  # fmt: skip


def _is_grid(arguments: argparse.Namespace) -> bool:
    return arguments.occupancy or Path(arguments.out).suffix.lower() == ".npy"


def _check_files(arguments: argparse.Namespace) -> tuple[Path, Path | None]:
    """Returns mesh or grid, and report, which have fitting names and do not exist."""
    from gsut.surface import check_grid_name, check_mesh_name

    out, to_grid = Path(arguments.out), _is_grid(arguments)
    (check_grid_name if to_grid else check_mesh_name)(out)
    if arguments.triangles and (to_grid or arguments.report):
        raise InputError("--triangles makes a mesh without depths: leave grids and --report out")
    if arguments.fit is not None and (to_grid or arguments.triangles):
        raise InputError("--fit is of the surface as a mesh: leave grids and --triangles out")
    report = Path(arguments.report) if arguments.report else None
    if report and (to_grid or report.suffix.lower() != ".html"):
        raise InputError(f"--report {report}: takes a name that ends in .html, of a mesh")
    for file in (out, out.with_suffix(".json") if to_grid else None, report):
        if file:
            refuse_existing(file)
    return out, report


def run(arguments: argparse.Namespace) -> int:
    from gsut.run import Progress, RunFolder
    from gsut.surface import (
        MeshOptions,
        extract_grid,
        fuse_depth,
        make_soup,
        render_depth_maps,
        save_grid,
        save_mesh,
    )
    from gsut.training import open_trained

    out, report = _check_files(arguments)
    to_grid = _is_grid(arguments)
    began = time.perf_counter()
    run = RunFolder.open(arguments.folder)
    options, scene, gaussians = open_trained(run, None)
    show_findings(scene, run, arguments.quiet)
    settings = MeshOptions(
        voxel=arguments.voxel,
        support=arguments.support,
        refine=arguments.refine,
        max_side=arguments.max_side,
        photographs=arguments.photographs,
        faces=arguments.faces,
        holes=arguments.holes,
        fit=arguments.fit,
        crop=None if arguments.crop is None else np.array(arguments.crop),
    )
    figures: dict[str, Any]
    with Progress(not arguments.quiet) as bars:
        behind: dict[str, Any] = {"background": options.background, "progress": bars.show}
        if arguments.triangles:
            made: Any = make_soup(gaussians, scene)
            figures = {"vertices": len(made.vertices), "faces": len(made.faces)}
        elif to_grid:
            made = extract_grid(gaussians, scene, settings, **behind)
            figures = {"shape": list(made.distances.shape), "voxel": made.voxel}
        else:
            maps = render_depth_maps(gaussians, scene, settings, **behind)
            made = fuse_depth(maps, settings, progress=bars.show)
            figures = {"vertices": len(made.vertices), "faces": len(made.faces)}
    if to_grid:
        save_grid(out, made, occupancy=arguments.occupancy)
    else:
        save_mesh(out, made)
        if report:
            seen = [scene.views[i] for i in scene.train_indices or range(len(scene.views))]
            write_file(
                report, _write_page(arguments.folder, made, list(zip(seen, maps, strict=True)))
            )
    figures |= {"seconds": time.perf_counter() - began, "out": str(out)}
    if arguments.json:
        print_json(figures)
    elif not arguments.quiet:
        print(f"{out}: {made}, {figures['seconds']:.1f} s")
    return 0


def _write_page(run: str, mesh: Any, maps: Sequence[tuple[Any, Any]]) -> str:
    """Writes a page of some views with their depth maps, and of the mesh as they see it."""
    from gsut.page import build_table, format_number
    from gsut.surface import SurfaceView, build_surface_page, choose_views

    views = [
        SurfaceView(seen.name, m.camera, m.motion, m.image, m.depth, turns=seen.turns)
        for seen, m in (maps[k] for k in choose_views(range(len(maps))))
    ]
    size = mesh.vertices.max(axis=0) - mesh.vertices.min(axis=0)
    rows = [
        ["vertices", format_number(len(mesh.vertices), 0)],
        ["faces", format_number(len(mesh.faces), 0)],
        ["size", " x ".join(format_number(side) for side in size)],
        ["depth maps", format_number(len(maps), 0)],
    ]
    return build_surface_page(f"Mesh of {run}", views, mesh, [build_table(rows)])
