"""`gsut points`: points of a dataset with its own poses, and colours of a cloud without any."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gsut._core import InputError
from gsut.cli._flags import add_force, add_json, add_quiet, check_first, print_json, whole
from gsut.files import refuse_existing

if TYPE_CHECKING:
    from gsut.data import Scene

HELP = "triangulate points with a dataset's own poses, or colour a cloud"
DESCRIPTION = (
    "Triangulates points with the poses, lenses, frame and unit that the dataset has, coloured "
    "from the photographs; `gsut train` starts from them. Or gives a cloud without colours, such "
    "as of a LiDAR, those of the photographs."
)
_DENSE = 200_000


def add_flags(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("data", metavar="DATA", help="the dataset")
    parser.add_argument(
        "-o",
        "--out",
        metavar="FILE.ply",
        help="new file of the points [default: DATA/triangulated.ply, which is read where DATA has "
        "no other points; with --colour CLOUD_coloured.ply]",
    )
    parser.add_argument(
        "--dense",
        type=whole,
        nargs="?",
        const=_DENSE,
        default=0,
        metavar="N",
        help="beside features follow about N pixels of all photographs into their neighbours by "
        f"optical flow; about a third become points [without a number {_DENSE}; default: "
        "features alone]",
    )
    parser.add_argument(
        "--colour",
        metavar="CLOUD.ply",
        help="colour the points of this file, in DATA's coordinates, in place of triangulating",
    )
    add_force(parser)
    add_quiet(parser)
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
    import gsut
    from gsut.data.points import TRIANGULATED, format_points_ply
    from gsut.files import write_file

    if arguments.dense < 0:
        raise InputError(f"--dense is {arguments.dense}; give the number of pixels to follow")
    scene = gsut.load_dataset(arguments.data, test_every=0)
    folder = scene.path if scene.path.is_dir() else scene.path.parent
    if arguments.colour:
        cloud = Path(arguments.colour)
        out = Path(arguments.out or cloud.with_name(f"{cloud.stem}_coloured.ply"))
    else:
        out = Path(arguments.out or folder / TRIANGULATED)
        if not arguments.out and len(scene.points):
            raise InputError(
                f"{arguments.data} has {len(scene.points):,} points, which stay in use: give "
                "another file for new ones with -o FILE.ply"
            )
    if out.suffix.lower() != ".ply":
        raise InputError(f"{out}: points are written as .ply; give such a name")
    refuse_existing(out, " with -o")
    check_first(scene.replace(points=np.zeros((0, 3)), point_colors=np.zeros((0, 3))),
                arguments.force, quiet=True)  # fmt: skip
    if arguments.colour:
        positions, colors, figures, words = _color_points(scene, cloud, arguments)
    else:
        positions, colors, figures, words = _triangulate(scene, arguments)
    write_file(out, format_points_ply(positions, colors))
    if arguments.json:
        print_json({**figures, "out": out})
    elif not arguments.quiet:
        print(f"{words}: {out}")
        if out == folder / TRIANGULATED:
            print(f"`gsut train {arguments.data} -o RUN` starts from them")
    return 0


def _triangulate(
    scene: Scene, arguments: argparse.Namespace
) -> tuple[np.ndarray, np.ndarray, dict[str, Any], str]:
    from gsut.run import Progress
    from gsut.sfm import triangulate

    with Progress(not arguments.quiet) as bars:
        found = triangulate(scene, dense=arguments.dense, on_progress=bars.show)
    figures = {
        "points": len(found),
        "photographs": len(scene),
        "error_px": float(np.median(found.errors)),
        "views": float(np.mean(found.views)),
    }
    words = (
        f"{len(found):,} points, each in {figures['views']:.1f} of {len(scene)} photographs, "
        f"median error {figures['error_px']:.3f} px"
    )
    return found.positions, found.colors, figures, words


def _color_points(
    scene: Scene, cloud: Path, arguments: argparse.Namespace
) -> tuple[np.ndarray, np.ndarray, dict[str, Any], str]:
    from gsut.data.points import color_points, find_usable_points, load_points_ply

    positions, _ = load_points_ply(cloud)
    if fault := find_usable_points(positions)[1]:
        raise InputError(f"{cloud}: {fault}; remove these points")
    near = scene.centred
    colors, views = color_points(
        near, positions - near.world_offset + scene.world_offset,
        progress=not arguments.quiet,
    )  # fmt: skip
    seen = int(np.count_nonzero(views))
    if not seen:
        raise InputError(
            f"no photograph of {arguments.data} sees any of the {len(positions):,} points of "
            f"{cloud}: are they in the dataset's coordinates and unit?"
        )
    figures = {"points": len(positions), "coloured": seen, "photographs": len(scene)}
    words = f"{seen:,} of {len(positions):,} points coloured (the others, seen by none, grey)"
    return positions, colors, figures, words
