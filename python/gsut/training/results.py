"""What training does before its first step and after its last: folder, first poses, judgement."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from gsut.data import Scene
from gsut.evaluate import evaluate
from gsut.gaussians import Gaussians
from gsut.run import Progress, RunFolder, TrainOptions

if TYPE_CHECKING:
    from gsut.refine import TracksResult


def create_run(
    out: str | os.PathLike[str], options: TrainOptions, scene: Scene, resume: bool
) -> RunFolder:
    """The folder of a new run, or of one that is resumed."""
    from gsut.run import describe_environment

    return RunFolder.create(
        out, options, resume=resume, environment=describe_environment(scene.path)
    )


def first_poses(scene: Scene, options: TrainOptions, progress: bool) -> TracksResult:
    """The training views' poses refined by tracks of features, with a bar if `progress`."""
    from gsut.refine import check_refinable, refine_by_tracks

    check_refinable(scene, options)
    bar = Progress(progress)
    try:
        return refine_by_tracks(scene, options, bar.show)
    finally:
        bar.close()


def judge(
    gaussians: Gaussians,
    scene: Scene,
    indices: Sequence[int],
    options: TrainOptions,
    run: RunFolder | None,
) -> tuple[Scene, dict[str, Any]]:
    """The evaluation of views; aligned first, and the scene with these poses, if poses moved."""
    renders = None if run is None else run.renders
    if options.refine_poses and scene.test_indices:
        from gsut.refine import evaluate_aligned

        return evaluate_aligned(
            gaussians, scene, indices, background=options.background, render_folder=renders
        )
    return scene, evaluate(
        gaussians, scene, indices, background=options.background, render_folder=renders
    )


def write_results(
    run: RunFolder, gaussians: Gaussians, metrics: dict[str, Any], refined: Scene | None
) -> None:
    """Writes scene.ply, metrics.json, report.html and, where poses were refined, these.

    Args:
        run: the folder.
        gaussians: of the scene; MixedGaussians do, too.
        metrics: see `run_metrics`; what could not be written is added to its notes.
        refined: the scene with refined poses, or None.
    """
    from gsut.evaluate import write_report
    from gsut.formats import save_ply

    offset = " ".join(f"{value:.17g}" for value in metrics["world_offset"])
    comment = f"gsut: dataset coordinates = these + {offset}"
    run.write("scene.ply", lambda path: save_ply(path, gaussians, comments=(comment,)))
    if refined is not None:
        from gsut.refine import write_refined

        metrics["notes"] += _refinement_notes(metrics)
        write_refined(run, refined)
    run.write_json("metrics.json", metrics)
    write_report(run)


def _refinement_notes(metrics: dict[str, Any]) -> list[str]:
    """What the report says about refined poses; nothing in a run that only takes them over."""
    refinement = metrics.get("refinement", {})
    notes = [each["note"] for each in (refinement.get("tracks", {}), refinement) if "note" in each]
    if "alignment" in metrics:
        aligned = metrics["alignment"]
        notes.append(
            f"{aligned['note']} PSNR before alignment {aligned['psnr_before']:.2f} dB, after "
            f"{aligned['psnr_after']:.2f} dB."
        )
    return notes
