"""`gsut train`: photographs with poses in, a trained scene and its report out."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Iterator
from typing import Any

from gsut._core import InputError
from gsut.cli._flags import (
    add_force,
    add_json,
    add_quiet,
    check_first,
    keep_findings,
    print_result,
    read_folder_name,
)
from gsut.cli.view import LivePage, add_live_flags
from gsut.output_folder import is_claimed
from gsut.run import BlockOptions, RunFile, RunFolder, TrainOptions, Verdict, read_plan
from gsut.run.options import add_option_flags, collect_given, fit_to_views
from gsut.system import format_command
from gsut.terminal import say

HELP = "train a scene on photographs"
DESCRIPTION = (
    "Trains a scene on photographs and writes scene.ply, metrics.json, report.html and a "
    "checkpoint to RUN."
)


def add_flags(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "data",
        metavar="DATA",
        help="dataset: photographs with lenses and poses, in any layout of docs/datasets.md",
    )
    parser.add_argument(
        "-o", "--out", metavar="RUN", required=True, type=read_folder_name, help="folder of the run"
    )
    parser.add_argument(
        "--resume",
        action="store_true",
        help="resume the run in RUN from its last checkpoint, with its own options; the result has "
        "the same bits as an uninterrupted run",
    )
    add_force(parser)
    add_quiet(parser)
    add_json(parser)
    add_live_flags(parser)
    add_option_flags(parser, TrainOptions, BlockOptions)


def run(arguments: argparse.Namespace) -> int:
    if arguments.resume and not is_claimed(arguments.out):
        raise InputError(
            f"{arguments.out} holds no run to resume; check the name, or leave --resume out to "
            "start a run there"
        )
    run = RunFolder.claim(arguments.out, "train", arguments.data)
    given = collect_given(TrainOptions, arguments)
    if arguments.resume and run.has_run():
        options = dataclasses.replace(run.read_given_options(), **given)
    else:
        options = TrainOptions(**given)
        if not arguments.resume:
            run.refuse_run(resumes=True)  # before the data is read: that may take a while
    blocks = _read_block_options(run, arguments)
    with LivePage(arguments) as page:
        metrics = train_into(
            run, arguments.data, options, arguments.resume, arguments.quiet, page, arguments.force,
            blocks,
        )  # fmt: skip
        print_result(arguments, metrics, summarize(metrics, run))
        page.stay()
    return 0


def summarize(metrics: dict[str, Any], run: RunFolder) -> Iterator[str]:
    """Summarizes a training in lines: figures, verdict, report."""
    yield from summarize_figures(metrics)
    if metrics.get("verdict"):
        yield str(Verdict.from_dict(metrics["verdict"]))
    yield f"report: {run.path / RunFile.REPORT}"


def _read_block_options(run: RunFolder, arguments: argparse.Namespace) -> BlockOptions | None:
    """Returns how the run is divided; None: not at all. A resumed run keeps its division.

    Raises:
        InputError: a flag that makes no sense without --blocks, or with it.
    """
    given = collect_given(BlockOptions, arguments)
    plan = read_plan(run) if arguments.resume else None
    if plan is not None:
        given = {"blocks": plan["blocks"]} | given
    elif arguments.resume and given and run.has_run():
        raise InputError(f"{run.path} was not started in blocks; leave --{next(iter(given))} out")
    if not given:
        return None
    if "blocks" not in given and "cluster" not in given:
        raise InputError(f"--{next(iter(given))} is for a training in --blocks; add --blocks auto")
    if arguments.view:
        raise InputError("--view shows a training as a whole; leave it out, or --blocks")
    return BlockOptions(**given)


def train_into(
    run: RunFolder,
    data: str,
    options: TrainOptions,
    resume: bool,
    quiet: bool,
    page: LivePage | None = None,
    force: bool = False,
    blocks: BlockOptions | None = None,
) -> dict[str, Any]:
    """Loads, checks, trains, and returns the content of metrics.json.

    Args:
        run: the folder.
        data: the dataset.
        options, resume: of the training.
        quiet: no bar, no notes.
        page: that shows the training.
        force: train although the data contradict themselves.
        blocks: train in blocks; None: as a whole.
    """
    import gsut

    scene = gsut.load_dataset(data, test_every=options.test_every, test_names=options.test_names)
    if blocks is None:
        options = fit_to_views(options, len(scene.train_indices))
    if not quiet:
        from gsut.data.points import UNCOLORED, has_colors
        from gsut.training.first import describe_resizing

        colors = UNCOLORED if len(scene.points) and not has_colors(scene) else None
        for note in filter(None, (*scene.notes, describe_resizing(scene, options), colors)):
            say(f"note: {note}")
    findings: list[Any] = []
    is_new = not (resume and run.has_run())
    if is_new:
        (run.path / RunFile.FINDINGS).unlink(missing_ok=True)
        mends = [s for s in ("poses", "lens") if getattr(options, f"refine_{s}")]
        findings = check_first(scene, force, quiet, mends)
        if any(each.severity != "info" for each in findings):  # which the verdict looks at
            keep_findings(run, findings)
    elif run.is_finished() and not quiet:
        say(f"note: {run.path} is finished; nothing in it changes")
    try:
        if blocks is not None:
            gsut.train_blocks(
                scene, options, blocks, out=run.path, resume=resume, progress=not quiet
            )
        else:
            watch = None if page is None else page.begin_training(scene, options)
            result = gsut.train(
                scene, options, out=run.path, resume=resume, progress=not quiet, watch=watch
            )
            if page is not None:
                page.finish(result)
    except gsut.InputError:
        if is_new and not run.has_run():  # nothing began: leave nothing behind
            (run.path / RunFile.FINDINGS).unlink(missing_ok=True)
        raise
    except KeyboardInterrupt as interrupt:
        kept = [] if blocks is None else blocks.list_words("blocks")
        resumed = ["--resume"] if run.has_run() else []
        again = format_command(["gsut", "train", data, "-o", str(run.path), *resumed, *kept])
        how = "resume from the last checkpoint" if resumed else "start again"
        kept_scene = run.path / RunFile.SCENE
        scene_kept = f"{kept_scene} holds the scene; " if kept_scene.is_file() else ""
        scene_kept = f"{interrupt}; " if str(interrupt) else scene_kept
        raise KeyboardInterrupt(f"interrupted; {scene_kept}to {how}, run: {again}") from None
    if is_new:
        keep_findings(run, findings)
    return run.read_json(RunFile.METRICS)


def summarize_figures(figures: dict[str, Any]) -> Iterator[str]:
    """Summarizes the headline figures and the rings in lines."""
    from gsut.evaluate import name_ring

    if figures.get("psnr") is None:
        yield "no held-out view, hence no PSNR"
    else:
        yield (
            f"PSNR {figures['psnr']:.2f} dB (worst {figures['psnr_min']:.2f} dB, "
            f"{figures['worst_view']}; colour-corrected {figures['psnr_color_corrected']:.2f} dB), "
            f"SSIM {figures['ssim']:.4f}"
        )
        rings = [
            f"{name_ring(ring)} {ring['psnr']:.2f}"
            for ring in figures["rings"]
            if ring["psnr"] is not None
        ]
        yield f"PSNR by field angle: {', '.join(rings)} dB"
    text = f"{figures['num_gaussians']:,} Gaussians"
    if figures.get("train_seconds") is not None:
        text += f", {figures['steps']} steps in {figures['train_seconds']:.1f} s"
    if figures.get("render_ms") is not None:
        text += f", {figures['render_ms']:.1f} ms a view"
    yield text
