"""`gsut align`: places one run in the frame of another, and shows what has changed."""

from __future__ import annotations

import argparse
from pathlib import Path

from gsut.cli._flags import add_json, print_result
from gsut.files import refuse_existing

HELP = "place a run in the frame of another; show what has changed"
DESCRIPTION = (
    "Locates photographs of RUN_B in the scene of RUN_A and prints the similarity from the "
    "coordinates of B to those of A, with its standard deviations."
)


def add_flags(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("first", metavar="RUN_A", help="a finished run, whose frame stays")
    parser.add_argument("other", metavar="RUN_B", help="another of the same place")
    parser.add_argument(
        "-o", "--out", metavar="FILE", help="scene file to write: B in the frame of A"
    )
    parser.add_argument(
        "--changes", metavar="FOLDER",
        help="pictures to write: what photographs of B saw, what has changed since A in red",
    )  # fmt: skip
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
    from gsut.formats import save_gaussians
    from gsut.refine.captures import align_captures, find_changes
    from gsut.render import choose_solid, write_png
    from gsut.run import Progress
    from gsut.training import load_run

    for path in filter(None, (arguments.out, arguments.changes)):
        refuse_existing(Path(path))
    first, second = (load_run(each) for each in (arguments.first, arguments.other))
    other = second.scene
    with Progress() as bars:
        found = align_captures(
            first.scene, first.gaussians, other,
            background=choose_solid(first.options.background),
            on_progress=bars.show,
        )  # fmt: skip
    moved = found.apply(second.gaussians)
    figures = {
        "matrix": found.matrix.tolist(), "scale": found.scale,
        "scale_sigma_percent": 100 * found.scale_sigma,
        "rotation_sigma_degrees": found.rotation_sigma, "position_sigma": found.position_sigma,
        "photographs": found.names, "rejected": found.rejected, "changed": {},
    }  # fmt: skip
    if arguments.out is not None:
        save_gaussians(arguments.out, moved)
    if arguments.changes is not None:
        folder = Path(arguments.changes)
        folder.mkdir()
        for index, view in enumerate(other.views):
            if view.name in found.names:
                pose = found.move_pose(other.to_dataset(view.camera_from_world))
                changed, picture = find_changes(first.gaussians, moved, other.camera(index), pose)
                write_png(folder / f"{Path(view.name).stem}.png", picture, view.turns)
                figures["changed"][view.name] = float(changed.mean())
    lines = [
        "coordinates of A from those of B:",
        *("  " + " ".join(f"{value:12.6f}" for value in row) for row in figures["matrix"]),
        f"scale {found.scale:.6g} +- {100 * found.scale_sigma:.2g} %, rotation +- "
        f"{found.rotation_sigma:.2g} degrees, positions +- {found.position_sigma:.2g}, by "
        f"{len(found.names)} photographs; {len(found.rejected)} do not agree or show another place",
        *(f"{name}: {share:.1%} has changed" for name, share in figures["changed"].items()),
    ]
    return print_result(arguments, figures, lines)
