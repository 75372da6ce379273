"""`gsut poses`: flags and words of `gsut.find_poses`."""

from __future__ import annotations

import argparse
import contextlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from gsut._core import InputError
from gsut.capture import capture, needs_capture
from gsut.cli._flags import add_capture, add_json, add_quiet, print_result, read_folder_name
from gsut.data import CAPTURE_FOLDER
from gsut.data.rigs import read_rig
from gsut.output_folder import claim_folder
from gsut.run import Progress, StagedProgress, StageFollower, Verdict
from gsut.run.options import add_option_flags, collect_given
from gsut.sfm import (
    PosesLog,
    PosesOptions,
    PosesResult,
    check_lens,
    find_poses,
    read_finished,
)

HELP = "camera poses and points of photographs, without COLMAP"
DESCRIPTION = (
    "Finds where photographs were taken, through any lens, and points that they see; writes a "
    "dataset that `gsut train` reads."
)


def add_flags(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "images",
        metavar="IMAGES",
        help="folder of photographs, a video, or a dataset (its poses are not looked at)",
    )
    add_capture(parser)
    parser.add_argument(
        "--camera",
        metavar="LENS",
        help="lens file, or a dataset whose lens is used; or the camera's name, such as 'GoPro "
        "HERO9 Black, Max Wide' (`gsut camera find`): the lens is then estimated from there "
        "[default: the one beside the images; if there is none the lens is estimated]",
    )
    parser.add_argument(
        "-o",
        "--out",
        type=read_folder_name,
        metavar="DATA",
        required=True,
        help="folder for transforms.json, points3D.ply, sparse/0 (COLMAP), poses.json and "
        "report.html; run the same command again to resume an interrupted run",
    )
    parser.add_argument(
        "--rig",
        metavar="RIG",
        help="file of several cameras that are fixed to each other: the report.json of "
        "`gsut calibrate --rig` (null for a lens file: it is estimated), or a camchain of Kalibr. "
        "IMAGES then holds one folder a camera; images of one frame (of one name, or else in "
        "order) share one pose, and poses and points are in the rig's unit",
    )
    add_quiet(parser)
    add_json(parser)
    add_option_flags(parser, PosesOptions)


def run(arguments: argparse.Namespace) -> int:
    options = PosesOptions(**collect_given(PosesOptions, arguments))
    if arguments.camera and arguments.rig:
        raise InputError("--camera contradicts --rig, whose file names the lenses; drop one")
    if arguments.camera and options.unknown_lens:
        raise InputError("--unknown-lens contradicts --camera; give one of them")
    if options.refine_rig and not arguments.rig:
        raise InputError("--refine-rig needs a rig; give its file by --rig")
    check_lens(arguments.camera)
    with claim_folder(arguments.out, "poses", arguments.images):
        images = capture_first(arguments, options)
        figures, is_new = find_once(images, arguments, options)
    kept = {key: value for key, value in figures.items() if key != "views"}
    return print_result(arguments, kept, summarize_poses(figures, Path(arguments.out), is_new))


def capture_first(arguments: argparse.Namespace, options: PosesOptions) -> str | os.PathLike[str]:
    """Chooses pictures of a video or of photographs without a lens; other inputs stay as given."""
    images = arguments.images
    if arguments.rig is not None or not needs_capture(
        images, arguments.camera, options.unknown_lens
    ):
        return images
    with Progress(not arguments.quiet) as bars:
        taken = capture(
            [images], Path(arguments.out) / CAPTURE_FOLDER, count=arguments.frames,
            on_progress=bars.show, nadir_cap=arguments.nadir_cap,
        )  # fmt: skip
        for note in taken.notes:
            bars.note(note)
    return taken.path


def find_once(
    images: str | os.PathLike[str], arguments: argparse.Namespace, options: PosesOptions
) -> tuple[dict[str, Any], bool]:
    """Returns the content of poses.json, and whether it was found now rather than earlier."""
    settings: dict[str, Any] = {"camera": arguments.camera, "options": options}
    if arguments.rig is not None:
        settings["camera"] = read_rig(arguments.rig)
    else:
        figures = read_finished(images, arguments.out, **settings)
        if figures is not None:
            return figures, False
    try:
        found = find_with_bar(images, arguments.out, not arguments.quiet, **settings)
        return found.figures, True
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"interrupted; the features and matches found so far are kept in {arguments.out}. Run "
            "the same command again to resume"
        ) from None


def find_with_bar(
    images: str | os.PathLike[str],
    out: str | os.PathLike[str],
    enabled: bool,
    **settings: Any,
) -> PosesResult:
    """Calls `find_poses` with one progress bar for all its stages."""
    with (
        StagedProgress("poses", enabled=enabled) as bars,
        contextlib.closing(StageFollower(bars)) as stages,
    ):
        log = PosesLog(stages.show, bars.note, stages.expect)
        return find_poses(images, out, log=log, **settings)


def summarize_poses(figures: dict[str, Any], out: Path, is_new: bool) -> Iterator[str]:
    """Summarizes what was found, in lines."""
    error = figures["reprojection_error_px"]
    yield (
        f"{figures['registered']} of {figures['images']} images registered, "
        f"{figures['points']:,} points, error {error['median']:.3f} px (median), "
        f"{error['rms']:.3f} px (rms), "
        + (f"{figures['seconds']['total']:.1f} s" if is_new else "already finished")
    )
    if "rig" in figures:
        yield describe_rig(figures["rig"])
    for lens in figures["lenses"] if figures["lens"] == "estimated" else []:
        values = " ".join(f"{value:.6g}" for value in lens["params"])
        yield f"lens found: {lens['model']} {values}"
    yield from _summarize_known_points(figures)
    yield str(Verdict.from_dict(figures["verdict"]))
    yield f"report: {out / 'report.html'}"


def _summarize_known_points(figures: dict[str, Any]) -> Iterator[str]:
    """Summarizes what is left at each marker and control point."""
    markers = figures.get("markers", {})
    for row in markers.get("found", []):
        edge = f"edge {row['edge']:.5g} m of {markers['edge']:g}, " if markers["applied"] else ""
        yield f"marker {row['id']}: in {row['views']} images, {edge}{row['residual_px']:.2f} px"
    for row in figures.get("control", {}).get("points", []):
        off = " ".join(f"{value:+.4f}" for value in row["residual"])
        pixels = "" if row["residual_px"] is None else f", {row['residual_px']:.2f} px"
        yield f"{row['use']} point {row['name']}: in {row['pictures']} images, {off} m{pixels}"


def describe_rig(rig: dict[str, Any]) -> str:
    """Returns how well a rig's cameras were placed, in one sentence."""
    if rig.get("found"):
        return (
            f"rig of two lenses found: {rig['frames_registered']} of {rig['frames_total']} frames, "
            f"the back one turned by {rig['turn_degrees']:.2f} degrees"
        )
    words = (
        f"rig: {rig['frames_registered']} of {rig['frames_total']} frames, in the unit of "
        f"{rig['file']} (baseline {rig['baseline']:.6g})"
    )
    if rig["scale_sigma_percent"] is not None:
        words += f", lengths good to {rig['scale_sigma_percent']:.2f} % (one sigma) if it is exact"
    if not rig["refined"]:
        return words
    changes = [
        f"{c['name']} turned {c['turned_degrees']:.3f} degrees, shifted {c['shifted']:.4g}"
        for c in rig["cameras"]
    ]
    return f"{words}; {'; '.join(changes)}"
