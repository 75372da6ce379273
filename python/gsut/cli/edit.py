"""`gsut edit`: a scene cut, levelled, scaled, or put together with others."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.bounds import LEAST_SCALE
from gsut.cli._flags import add_json, finite, print_result
from gsut.cli.convert import find_scene_file
from gsut.files import refuse_existing

HELP = "cut, level, scale and merge scenes"
DESCRIPTION = (
    "Reads scenes (runs, or files of Gaussians of any known format) and writes one file. Edits "
    "are made in this order: floaters, merge, apply, crop, opacity, up or ground, scale. Places "
    "are in the coordinates of IN. IN stays as it is; an existing OUT is rejected."
)

_WORKING = 5.0  # of the Gaussians' numbers, beside them: turned in float64, and written


def add_flags(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "sources", metavar="IN", nargs="+", help="finished runs or files; several are merged"
    )
    parser.add_argument(
        "-o", "--out", metavar="OUT", required=True, help="the file; its suffix says the format"
    )
    parser.add_argument(
        "--apply", metavar="FILE.json",
        help="repeat the edits that the viewer saved, also those made on another training of the "
        "same dataset and poses",
    )  # fmt: skip
    parser.add_argument(
        "--crop-box",
        type=float,
        nargs=6,
        metavar=("X", "Y", "Z", "X", "Y", "Z"),
        help="keep what lies between these two corners",
    )
    parser.add_argument(
        "--min-opacity", type=finite, metavar="X", help="leave out what is less opaque, of 0 to 1"
    )
    parser.add_argument(
        "--floaters", action="store_true",
        help="leave out what a run's training photographs contradict or none of them shows",
    )  # fmt: skip
    parser.add_argument(
        "--up", type=finite, nargs=3, metavar=("X", "Y", "Z"),
        help="turn the scene so that this direction is up (-y, as viewers take it)",
    )  # fmt: skip
    parser.add_argument(
        "--upright", action="store_true", help="the same with the mean up of a run's cameras"
    )
    parser.add_argument(
        "--ground", action="store_true",
        help="find the ground, within 30 degrees of --up or --upright [default], and make it y = 0",
    )  # fmt: skip
    parser.add_argument(
        "--scale",
        type=finite,
        metavar="X",
        help="multiply all lengths by X (from a known length: gsut measure)",
    )
    parser.add_argument(
        "--positions", metavar="FILE.csv",
        help="instead of up and scale: where a run's photographs were taken, by GPS or surveyed; a "
        "line each under a heading name,latitude,longitude,altitude or name,x,y,z (metres, z up). "
        "Afterwards x is east, -y up and z north, and lengths are metres",
    )  # fmt: skip
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
    from gsut.edit import apply_edits, merge_gaussians, read_edits, transform_gaussians
    from gsut.formats import (
        WriteSettings,
        check_room,
        choose_format,
        read_scene_file,
        save_gaussians,
    )

    out = Path(arguments.out)
    choose_format(out)
    refuse_existing(out)
    scale = _scale_of(arguments)
    files = [read_scene_file(find_scene_file(Path(source))) for source in arguments.sources]
    if len({file.antialiased for file in files}) > 1:
        raise InputError(
            "some of these scenes are antialiased and others are not: no one file fits"
        )
    parts = [file.gaussians for file in files]
    check_room("editing", parts, _WORKING)
    found = sum(map(len, parts))
    if arguments.floaters:
        parts = [
            _remove_unsupported(arguments, *each)
            for each in zip(arguments.sources, parts, strict=True)
        ]
    whole = merge_gaussians(parts)
    supported = len(whole)
    if arguments.apply:
        whole = whole[apply_edits(whole, read_edits(arguments.apply))]
    kept = whole[_select_kept(whole, arguments)]
    if len(kept) == 0:
        raise InputError("nothing is left; cut less (--apply, --crop-box, --min-opacity)")
    if arguments.positions:
        fit = _fit_of_positions(arguments)
        scale, rotation, translation = fit.scale, fit.rotation, fit.translation
    else:
        rotation, height = _find_level(arguments, kept)
        translation = scale * np.array([0.0, height, 0.0])
    moved = transform_gaussians(kept, rotation, scale, translation)
    written = save_gaussians(out, moved, WriteSettings(antialiased=files[0].antialiased))
    figures = {
        "num_gaussians": len(moved),
        "source_num_gaussians": found,
        "floaters": found - supported,
        "removed_by_hand": supported - len(whole),
        "rotation": rotation,
        "translation": translation,
        "scale": scale,
        "positions_rms": fit.rms if arguments.positions else None,
        "upside_down": arguments.positions is not None and fit.is_upside_down,
        "out": str(out),
        "left_out": list(written.left_out),
    }
    return print_result(arguments, figures, _summarize(figures))


def _summarize(figures: dict[str, Any]) -> Iterator[str]:
    yield (
        f"{figures['num_gaussians']:,} of {figures['source_num_gaussians']:,} Gaussians, lengths "
        f"times {figures['scale']:.6g}: {figures['out']}"
    )
    if figures["floaters"]:
        yield f"{figures['floaters']:,} left out by what the photographs say"
    if figures["removed_by_hand"]:
        yield f"{figures['removed_by_hand']:,} removed by the edits"
    if figures["positions_rms"] is not None:
        yield f"the cameras are {figures['positions_rms']:.3g} m (rms) from where the file says"
    if figures["upside_down"]:
        yield "the cameras are upside down now: are x and y, or north and east, swapped?"
    yield from figures["left_out"]


def _scale_of(arguments: argparse.Namespace) -> float:
    others = (arguments.scale, arguments.up)
    by_hand = arguments.upright or arguments.ground or any(each is not None for each in others)
    if arguments.positions and by_hand:
        raise InputError("--positions says scale and up; give no other of them")
    scale = 1.0 if arguments.scale is None else arguments.scale
    if not LEAST_SCALE <= scale <= 1 / LEAST_SCALE:
        raise InputError(
            f"--scale must be above 0, from {LEAST_SCALE:g} to {1 / LEAST_SCALE:g}, found {scale:g}"
        )
    return float(scale)


def _select_kept(gaussians: Any, arguments: argparse.Namespace) -> np.ndarray:
    """Selects what --crop-box and --min-opacity leave, as (N,) bool."""
    from gsut.edit import is_inside_box

    kept, least = np.ones(len(gaussians), bool), arguments.min_opacity
    if arguments.crop_box is not None:
        corners = np.reshape(arguments.crop_box, (2, 3))
        kept &= is_inside_box(gaussians, corners.min(axis=0), corners.max(axis=0))
    if least is not None:
        if not 0 <= least <= 1:
            raise InputError(f"--min-opacity must lie in 0 to 1, found {least}")
        kept &= 1 / (1 + np.exp(-gaussians.opacity_logits.astype(np.float64))) >= least
    return kept


def _find_level(arguments: argparse.Namespace, gaussians: Any) -> tuple[np.ndarray, float]:
    """Finds the rotation that turns up to -y, and how far below y = 0 the ground then lies."""
    from gsut.gaussians import find_ground, rotate_upright

    if arguments.up is not None and arguments.upright:
        raise InputError("give --up or --upright, not both")
    if arguments.up is None and not (arguments.upright or arguments.ground):
        return np.eye(3), 0.0
    up = _find_up_of_cameras(arguments) if arguments.up is None else np.array(arguments.up)
    if not (np.isfinite(up).all() and np.any(up)):
        raise InputError(f"--up must be a direction, found {arguments.up}")
    if not arguments.ground:
        return rotate_upright(up), 0.0
    normal, level = find_ground(gaussians, up)
    return rotate_upright(normal), level


def _find_up_of_cameras(arguments: argparse.Namespace) -> np.ndarray:
    scene = _load_run(arguments.sources[0], "say what is up by --up X Y Z").scene
    rows = scene.train_indices or range(len(scene))
    poses = np.stack([scene.views[row].camera_from_world for row in rows])
    return -poses[:, 1, :3].mean(axis=0)


def _load_run(source: str, otherwise: str) -> Any:
    from gsut.training import load_run

    if not Path(source).is_dir():
        raise InputError(f"{source} is a file, which has no cameras: {otherwise}")
    return load_run(source)


def _remove_unsupported(arguments: argparse.Namespace, source: str, gaussians: Any) -> Any:
    from gsut.compact import find_support
    from gsut.run import Progress

    run = _load_run(source, "give a run for --floaters")
    rows = run.scene.train_indices
    with Progress(not arguments.json) as bars:
        support = find_support(
            run.scene, gaussians, rows, background=run.options.background, light=run.light,
            on_view=lambda done: bars.show("photographs", done, len(rows)),
        )  # fmt: skip
    return gaussians[~(support.contradicted | support.unseen)]


def _fit_of_positions(arguments: argparse.Namespace) -> Any:
    from gsut.sfm import fit_positions, read_positions

    positions = read_positions(arguments.positions)
    scene = _load_run(arguments.sources[0], "give a run for --positions").scene
    poses = {view.name: scene.to_dataset(view.camera_from_world) for view in scene.views}
    return fit_positions(poses, positions, arguments.positions)
