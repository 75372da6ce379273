"""Measures a finished training and writes its files."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsut.data import Scene
from gsut.evaluate import (
    evaluate,
    is_beside,
    run_metrics,
    write_report,
)
from gsut.formats import NO_BACKGROUND, name_origin, prepare_for_file, save_ply
from gsut.gaussians import Gaussians
from gsut.judge.checks import judge_training
from gsut.refine import evaluate_aligned, write_refined
from gsut.render import Light
from gsut.run import RunFile, RunFolder, TrainOptions
from gsut.training.loop import TrainingLoop
from gsut.training.photograph import Movers
from gsut.training.record.marked import write_marked
from gsut.training.record.trained_run import TrainedRun

# Training views that are measured if none is held out: each takes a render.
_MOST_MEASURED = 8
# Training views that are measured beside held-out ones, to show how far these fall behind.
_BESIDE = 4


def measure(
    trained: TrainedRun,
    indices: Sequence[int],
    run: RunFolder | None,
    *,
    steps: int,
    train_seconds: float,
    align: bool = False,
    find_movers: Callable[[Scene], Callable[[int, int, int], Any] | None] | None = None,
) -> tuple[Scene, dict[str, Any]]:
    """Computes the content of metrics.json.

    Args:
        trained: the result of a training, with the light of its photographs, if it was found.
        indices: of the views to measure.
        run: receives pictures of these views.
        steps, train_seconds: see `run_metrics`.
        align: align test views with the Gaussians first, since the training views' poses have
            moved.
        find_movers: called with the scene as it is judged; returns `find_moving` of `evaluate`.
            None: nothing moved.

    Returns:
        The scene, with the aligned poses, and the figures.
    """
    options, scene, gaussians, light = trained
    settings: dict[str, Any] = {
        "background": options.background,
        "light": light,
        "render_folder": None if run is None else run.renders,
    }
    if align and scene.test_indices:
        scene, evaluation = evaluate_aligned(
            gaussians, scene, indices, find_movers=find_movers, **settings
        )
    else:
        find_moving = find_movers and find_movers(scene)
        evaluation = evaluate(gaussians, scene, indices, find_moving=find_moving, **settings)
    metrics = run_metrics(
        evaluation, gaussians, scene, options, steps=steps, train_seconds=train_seconds
    )
    if light is not None:
        metrics["light"] = light.as_dict([view.name for view in scene.views])
        metrics["notes"].append(light.note())
    metrics["evaluated_on"] = "test views" if scene.test_indices else "training views"
    return scene, metrics


def measure_training(
    loop: TrainingLoop, gaussians: Gaussians, scene: Scene, run: RunFolder | None
) -> tuple[Scene, dict[str, Any]]:
    """Measures a finished training on its test views, or on some training views if it has none."""
    light, background = loop.photographs.find_light(), loop.options.background
    movers, measured = loop.outliers.movers, scene.test_indices

    def find_movers(judged: Scene) -> Callable[[int, int, int], Any]:
        if not (movers.masks and measured):
            return movers.scale_mask
        return Movers.find(gaussians, judged, measured, light).scale_mask

    scene, metrics = measure(
        TrainedRun(loop.options, scene, gaussians, light),
        measured or scene.train_indices[:_MOST_MEASURED], run, steps=loop.step,
        train_seconds=loop.seconds, align=loop.options.refine_poses,
        find_movers=find_movers,
    )  # fmt: skip
    metrics["moving_train"] = loop.outliers.movers.measure_share(len(scene.train_indices))
    if run is not None:
        metrics["marked"] = [*_mark_fixed(run, scene), *_mark_moved(run, scene, movers)]
    if scene.test_indices:
        some = scene.train_indices[:: -(-len(scene.train_indices) // _BESIDE)]
        how: dict[str, Any] = {"background": background, "light": light}
        trained = evaluate(
            gaussians, scene, some, find_moving=movers.scale_mask, keep_patches=True, **how
        )
        metrics |= {f"{key}_train": trained[key] for key in ("psnr", "detail")}
        metrics |= _summarize_patches(trained["views"], some, movers)
        if run is not None and statistics.median(row["patch"] for row in trained["views"]) > 0:
            metrics["marked"].append(_mark_patch(run, scene, trained["views"], some))
    metrics["notes"] += loop.notes
    if loop.refiner is not None:
        metrics["refinement"] = loop.refiner.summarize()
    return scene, metrics


def _summarize_patches(
    rows: Sequence[dict[str, Any]], views: Sequence[int], movers: Movers
) -> dict[str, float]:
    """Summarizes the wrong patches of training views, and their detail outside these.

    A patch that does not lie beside what moved in its view is something else, and counts as none.
    """
    pairs = [
        (row["patch"], row["detail_outside"])
        if is_beside(row["wrong_patch"], movers.masks.get(view))
        else (0.0, row["detail"])
        for row, view in zip(rows, views, strict=True)
    ]
    patch, outside = map(statistics.median, zip(*pairs, strict=True))
    return {"patch_train": patch, "detail_outside_train": outside}


def _mark_patch(
    run: RunFolder, scene: Scene, rows: Sequence[dict[str, Any]], views: Sequence[int]
) -> dict[str, Any]:
    """Writes the photograph of which a wrong patch takes most, with it marked."""
    row, view = max(zip(rows, views, strict=True), key=lambda pair: pair[0]["patch"])
    text = "far less detail is right here than in the rest of the picture"
    return write_marked(run, scene, view, row["wrong_patch"], "patch.png", text)


def _mark_fixed(run: RunFolder, scene: Scene) -> list[dict[str, Any]]:
    """Writes a photograph for each different set of fixed pixels, with these marked."""
    first: dict[int, tuple[int, np.ndarray]] = {}  # by the array
    for index in scene.train_indices:
        fixed = scene.fixed[scene.views[index].camera_index] if scene.fixed else None
        if fixed is not None:
            first.setdefault(id(fixed), (index, fixed))
    text = "pixels that show the same in all images, left out"
    return [
        write_marked(run, scene, index, fixed, f"fixed_{number}.png", text)
        for number, (index, fixed) in enumerate(first.values())
    ]


def _mark_moved(run: RunFolder, scene: Scene, movers: Movers) -> list[dict[str, Any]]:
    """Writes the training photograph of which movers take most, with these marked."""
    if not movers.masks:
        return []
    view = max(movers.masks, key=lambda index: float(movers.masks[index].mean()))
    mask, share = movers.masks[view], movers.measure_share(len(scene.train_indices))
    text = f"what moved past, left out: {100 * mask.mean():.0f} % of this photograph, "
    text += f"{100 * share:.1f} % of all"
    return [write_marked(run, scene, view, mask, "moved.png", text)]


def write_results(
    run: RunFolder,
    gaussians: Gaussians,
    metrics: dict[str, Any],
    data: Path,
    refined: Scene | None,
    options: TrainOptions,
) -> None:
    """Writes scene.ply, metrics.json, report.html and, if poses were refined, these.

    Args:
        run: the folder.
        gaussians: in coordinates whose origin is the metrics' world_offset.
        metrics: see `run_metrics`; gets the verdict, and notes on what could not be written.
        data: path of the dataset, for the verdict's advice.
        refined: the scene with refined poses, or None.
        options: of the training as given, for the verdict's advice.
    """
    in_dataset = gaussians.translate(metrics["world_offset"])
    metrics["notes"] += describe_place(prepare_for_file(in_dataset).origin)
    _write_scene(run, in_dataset, "light" in metrics)
    write_findings(run, metrics, data, refined, options)


def write_unfinished(run: RunFolder, loop: TrainingLoop) -> None:
    """Writes scene.ply, and refined poses if there are any, of a training between two steps."""
    in_dataset = loop.make_result().translate(loop.scene.world_offset)
    _write_scene(run, in_dataset, loop.photographs.find_light() is not None)
    if loop.options.refine_poses:
        write_refined(run, loop.scene)


def _write_scene(run: RunFolder, gaussians: Gaussians, with_light: bool) -> None:
    comments = list_scene_comments(run, with_light)
    run.write(RunFile.SCENE, lambda path: save_ply(path, gaussians, comments))


def list_scene_comments(run: RunFolder, with_light: bool) -> list[str]:
    """Returns the comments for the header of a run's scene.ply.

    Args:
        run: the folder.
        with_light: whether exposure or falloff of the photographs was found.
    """
    without = [NO_BACKGROUND] if run.read_options().background is None else []
    return without + ([f"gsut: {Light.SHOWN}"] if with_light else [])


def describe_place(origin: np.ndarray) -> list[str]:
    """Returns a note on the origin (3,) of scene.ply, if it is not the dataset's."""
    if not origin.any():
        return []
    return [f"scene.ply holds {name_origin(origin)}; its comment says so, gsut reads it back"]


def write_findings(
    run: RunFolder,
    metrics: dict[str, Any],
    data: Path,
    refined: Scene | None,
    options: TrainOptions,
    division: Sequence[str] = (),
) -> None:
    """Writes what `write_results` does, except scene.ply, which exists; `division`: see
    `judge_training`."""
    if refined is not None:
        metrics["notes"] += _list_refinement_notes(metrics)
        write_refined(run, refined)
    scene = (run.read_json(RunFile.STATE) or {}).get("key")
    verdict = judge_training(
        metrics, str(data), str(run.path), options, division, find_accused(run), scene
    )
    metrics["verdict"] = verdict.as_dict()
    run.write_json("metrics.json", metrics)
    write_report(run)


def find_accused(run: RunFolder) -> dict[str, str] | None:
    """Finds the doctor's first finding against poses or lens, if all are against one of them."""
    found = (run.read_json(RunFile.FINDINGS) or {}).get("findings", [])
    against = [each for each in found if each["subject"]]
    return against[0] if len({each["subject"] for each in against}) == 1 else None


def _list_refinement_notes(metrics: dict[str, Any]) -> list[str]:
    """Returns the report's notes on refined poses; none in a run that only takes them over."""
    refinement = metrics.get("refinement", {})
    notes = [each["note"] for each in (refinement.get("tracks", {}), refinement) if "note" in each]
    if "alignment" in metrics:
        aligned = metrics["alignment"]
        notes.append(
            f"{aligned['note']} PSNR before alignment {aligned['psnr_before']:.2f} dB, after "
            f"{aligned['psnr_after']:.2f} dB."
        )
    return notes
