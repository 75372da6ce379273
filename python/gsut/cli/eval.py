"""`gsut eval`: the figures of a finished run on its held-out images."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from gsut._core import InputError
from gsut.cli._flags import (
    add_json,
    add_run,
    print_result,
    read_folder_name,
    show_findings,
)
from gsut.files import whole_folder
from gsut.terminal import say

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
        type=read_folder_name,
        metavar="FOLDER",
        help="new folder for the pictures (truth, render, 16-bit distance) and metrics.json",
    )
    parser.add_argument(
        "--geometry",
        nargs="?",
        const="",
        metavar="TRUTH",
        help="also judge depth and mesh: a mesh (.ply, .obj; only what training views see of it "
        "counts), a point cloud (.ply), or a folder of depths along the rays named like the images "
        "(.npy, or .png of 16 bits in thousandths of the dataset's unit) [alone: the depth files "
        "that the dataset names]",
    )
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
    from gsut.cli.train import summarize_figures
    from gsut.run import RunFolder
    from gsut.training import open_trained

    run = RunFolder.open(arguments.folder)
    options, scene, gaussians = open_trained(run, None)
    indices = {
        "test": scene.test_indices,
        "train": scene.train_indices,
        "all": list(range(len(scene.views))),
    }[arguments.split]
    if not indices:
        raise InputError(
            f"{scene.path} has no {arguments.split} views with these options; try --split all"
        )
    with whole_folder(arguments.out) if arguments.out else contextlib.nullcontext() as out:
        show_findings(scene, run)
        figures = _measure_run(arguments, run, options, scene, gaussians, indices, out)
    lines = [
        *(f"{row['psnr']:7.2f} dB  SSIM {row['ssim']:.4f}  {row['name']}"
          for row in figures["views"]),
        *summarize_figures(figures),
        *_summarize_geometry(figures.get("geometry", {})),
    ]  # fmt: skip
    return print_result(arguments, figures, lines)


def _measure_run(
    arguments: argparse.Namespace,
    run: Any,
    options: Any,
    scene: Any,
    gaussians: Any,
    indices: Sequence[int],
    out: Path | None,
) -> dict[str, Any]:
    """Returns the content of metrics.json; with `out`, writes it there beside the pictures."""
    from gsut.evaluate import evaluate
    from gsut.run import Progress, RunFile, RunFolder
    from gsut.surface import judge_geometry
    from gsut.training import read_light
    from gsut.training.record import find_run_movers

    light = read_light(run, scene)
    with Progress() as bars:
        figures = evaluate(
            gaussians,
            scene,
            indices,
            background=options.background,
            light=light,
            find_moving=find_run_movers(run, gaussians, scene, indices, light),
            render_folder=out,
            on_view=lambda done, total: bars.show("views", done, total),
        )
    figures["num_gaussians"] = len(gaussians)
    if options.refine_poses:
        say("note: poses as the run refined them, held-out views aligned")
    if arguments.geometry is not None:
        with Progress() as bars:
            figures["geometry"] = judge_geometry(
                gaussians, scene, indices,
                Path(arguments.geometry) if arguments.geometry else None,
                background=options.background, progress=bars.show,
            )  # fmt: skip
    if out is not None:
        RunFolder(out).write_json(RunFile.METRICS, figures)
    return figures


def _summarize_geometry(geometry: dict[str, Any]) -> Iterator[str]:
    """Yields a line for each kind of depth, with its rings, and for the mesh."""
    depth = dict(geometry.get("depth", {}))
    views = depth.pop("views", 0)
    for kind, row in depth.items():
        if row["abs_rel"] is None:
            yield f"depth, {kind}: none where the truth is known"
            continue
        rings = ", ".join(
            f"{100 * ring['abs_rel_median']:.2f} % to {ring['to_degrees']:.0f}°"
            for ring in row["rings"]
            if ring["abs_rel_median"] is not None
        )
        yield (
            f"depth, {kind}: AbsRel {100 * row['abs_rel']:.2f} % (median "
            f"{100 * row['abs_rel_median']:.2f} %; {rings}), RMSE {row['rmse']:.4g}, delta < 1.25 "
            f"{100 * row['delta1']:.1f} %, on {100 * row['coverage']:.1f} % of {views} views"
        )
    if mesh := geometry.get("mesh"):
        normals = mesh["normal_consistency"]
        yield (
            f"mesh: accuracy {mesh['accuracy']:.4g}, completeness {mesh['completeness']:.4g}, "
            f"Chamfer {mesh['chamfer']:.4g}"
            + ("" if normals is None else f", normal consistency {normals:.3f}")
        )
        for row in mesh["fscores"]:
            yield (
                f"mesh: F-score {row['fscore']:.3f} at {row['distance']:g} (precision "
                f"{row['precision']:.3f}, recall {row['recall']:.3f})"
            )
