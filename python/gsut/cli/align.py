"""`gsut align`: places a run in the frame of another, or of a cloud; shows what has changed."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from gsut._core import InputError
from gsut.cli._flags import add_json, is_run, print_result
from gsut.files import refuse_existing

HELP = "place a run in the frame of another or of a laser scan; show what has changed"
DESCRIPTION = (
    "Locates photographs of B in the scene of A, or the distances that they show in the cloud A, "
    "and prints the similarity from the coordinates of B to those of A, with its standard "
    "deviations."
)
_CLOUDS = (".las", ".laz", ".ply")


def add_flags(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "first", metavar="A",
        help="a finished run, or a cloud (.las, .laz, .ply) in any unit, whose frame stays",
    )  # fmt: skip
    parser.add_argument(
        "other", metavar="B", help="a run of the same place; a dataset where A is a cloud"
    )
    parser.add_argument(
        "-o", "--out", metavar="OUT",
        help="B in the frame of A: a scene file, of a dataset a new one with the points of A",
    )  # fmt: skip
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
    cloud = Path(arguments.first)
    if cloud.suffix.lower() in _CLOUDS:
        return _align_to_cloud(arguments)
    if cloud.is_file():
        raise InputError(f"{cloud}: a cloud is read from {', '.join(_CLOUDS)}; export it as one")
    first, second = (load_run(each) for each in (arguments.first, arguments.other))
    other = second.scene
    with Progress() as bars:
        found = align_captures(
            first.scene, first.gaussians, other,
            background=choose_solid(first.options.background),
            on_progress=bars.show,
        )  # fmt: skip
    moved = found.apply(second.gaussians)
    figures = _list_figures(found) | {"changed": {}}
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
    shares = [f"{name}: {share:.1%} has changed" for name, share in figures["changed"].items()]
    return print_result(arguments, figures, [*_describe(found), *shares])


def _align_to_cloud(arguments: argparse.Namespace) -> int:
    from gsut.data import convert_dataset, load_dataset
    from gsut.data.points import load_points
    from gsut.formats import save_gaussians
    from gsut.refine.captures import align_to_cloud
    from gsut.training import load_run

    if arguments.changes is not None:
        raise InputError("--changes compares two runs, and A is a cloud")
    run = load_run(arguments.other) if is_run(Path(arguments.other)) else None
    scene = load_dataset(arguments.other, test_every=0) if run is None else run.scene
    found = align_to_cloud(load_points(arguments.first)[0], scene)
    figures: dict[str, Any] = _list_figures(found) | {"notes": []}
    if arguments.out is not None and run is not None:
        save_gaussians(arguments.out, found.apply(run.gaussians))
    elif arguments.out is not None:
        figures["notes"] = convert_dataset(
            arguments.other, arguments.out, cloud=(arguments.first, found.matrix)
        )
    notes = [f"note: {each}" for each in figures["notes"]]
    return print_result(arguments, figures, [*_describe(found), *notes])


def _list_figures(found: Any) -> dict[str, Any]:
    return {
        "matrix": found.matrix.tolist(), "scale": found.scale,
        "scale_sigma_percent": 100 * found.scale_sigma,
        "rotation_sigma_degrees": found.rotation_sigma, "position_sigma": found.position_sigma,
        "photographs": found.names, "rejected": found.rejected,
    }  # fmt: skip


def _describe(found: Any) -> list[str]:
    return [
        "coordinates of A from those of B:",
        *("  " + " ".join(f"{value:12.6f}" for value in row) for row in found.matrix.tolist()),
        f"scale {found.scale:.6g} +- {100 * found.scale_sigma:.2g} %, rotation +- "
        f"{found.rotation_sigma:.2g} degrees, positions +- {found.position_sigma:.2g}, by "
        f"{len(found.names)} photographs; {len(found.rejected)} do not agree or show another place",
    ]
