"""The whole way from photographs to Gaussians, one line a stage: read this file first.

Each line names the folder that does it; `TrainingLoop.advance` (training/loop.py) is one step.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable
from typing import Any

from gsut import _core
from gsut._core import InputError
from gsut.bounds import name_wrong_kinds
from gsut.check import refuse_too_large
from gsut.data import Scene
from gsut.gaussians import Gaussians
from gsut.run import Progress, TrainOptions
from gsut.run.options import fit_to_views
from gsut.training import TrainingLoop, choose_degree
from gsut.training.first import (
    choose_number,
    describe_fixed,
    find_plain_background,
    prepare_scene,
    refine_first_poses,
)
from gsut.training.record import TrainingRecord, measure_training, write_results
from gsut.training.surface import check_maps


@dataclasses.dataclass
class TrainResult:
    """The result of `train`: Gaussians, figures and history.

    Attributes:
        gaussians: the scene's Gaussians, in the dataset's coordinates; their `origin` is where
            training worked.
        metrics: the content of metrics.json.
        history: one dict a logged step: step, seconds, cpu_seconds, loss, num_gaussians, psnr.
        scene: at the size trained at, with the poses and lens as they were refined (if requested).
    """

    gaussians: Gaussians
    metrics: dict[str, Any]
    history: list[dict[str, Any]]
    scene: Scene

    def __repr__(self) -> str:
        psnr = self.metrics["psnr"]
        judged = "" if psnr is None else f", {psnr:.2f} dB on {self.metrics['evaluated_on']}"
        return f"TrainResult({self.gaussians}, {self.metrics['steps']} steps{judged})"


@name_wrong_kinds
def train(
    scene: Scene,
    options: TrainOptions | None = None,
    *,
    out: str | os.PathLike[str] | None = None,
    resume: bool = False,
    progress: bool | Callable[[dict[str, Any]], None] = True,
    watch: Callable[[TrainingLoop, dict[str, Any]], bool] | None = None,
) -> TrainResult:
    """Trains Gaussians on a scene's training views; its test views are only measured.

    Args:
        scene: from `load_dataset`.
        options: every setting of the run; None: the defaults.
        out: run folder that gets scene.ply, metrics.json, report.html, checkpoints ...; None: no
            files.
        resume: go on from the checkpoint in `out`, to the same bits as an unbroken run.
        progress: True shows a bar; a function gets each row of the history, with "seconds_left".
        watch: called after each step with the loop, to look at and not to change, and its row of
            the history ({} for most steps); the training ends where it returns False.

    Returns:
        Gaussians, metrics and history. The same seed gives the same bits on any number of threads.

    Raises:
        InputError: no training view, an option out of range, or `out` holds a run.
        DatasetError: a photograph or a mask cannot be used, or memory does not suffice.
    """
    asked = fit_to_views(options or TrainOptions(), len(scene.train_indices))
    _core.set_num_threads(asked.threads)
    if not scene.train_indices:
        raise InputError(f"{scene.path} has no training view; hold out fewer (--test-every)")
    refuse_too_large(scene, asked)  # check/: of the memory that is free
    given, scene = scene, prepare_scene(scene.centred, asked)  # data/: size of the images, shutter
    scene.check_pixels()  # data/: a damaged photograph is found now
    check_maps(scene)  # check/: depth files that are damaged or contradict the photographs
    with Progress(progress is True) as bar:  # of the harmonics, by two short trainings
        asked, degree_because = choose_degree(scene, asked, bar.show)
    o = asked
    if o.background is None:
        o = dataclasses.replace(o, background=find_plain_background(scene))
    # run/: folder, history, checkpoints
    record = TrainingRecord(out, o, scene, resume, progress, watch)
    for note in describe_fixed(scene):
        record.note(note)
    fresh = record.checkpoint is None
    tracks = refine_first_poses(scene, o, progress is True) if fresh else None  # sfm/, refine/
    # the number of Gaussians that the photographs support
    number, notes = choose_number(scene, asked)
    notes += [degree_because] if degree_because else []
    for note in notes:
        record.note(note)
    o = dataclasses.replace(o, max_gaussians=number)
    loop = TrainingLoop(scene, o, tracks=tracks)  # gaussians/: the first ones
    with record.follow(loop):
        while loop.step < o.steps and record.goes_on:
            # data/ -> render/ -> loss and back -> optimize/ -> training/strategies/ -> refine/
            record.add(loop, loop.advance())
    if loop.step < o.steps:
        loop.notes.append(f"the training was stopped after {loop.step} of {o.steps} steps")
    gaussians = loop.make_result().copy()  # optimize/: the mean over the last steps
    scene = loop.finish_scene()  # refine/: poses and lens against the finished Gaussians
    scene, metrics = measure_training(loop, gaussians, scene, record.run)  # evaluate/
    for note in metrics["notes"][len(scene.notes) :]:
        record.note(note)
    metrics["notes"] += notes
    if record.run is not None:
        refined = scene if o.refine_poses else None  # formats/, verdict
        write_results(record.run, gaussians, metrics, scene.path, refined, asked)
    gaussians = gaussians.translate(scene.world_offset)
    scene = scene.move_origin((0.0, 0.0, 0.0)) if o.refine_poses else prepare_scene(given, o)
    return TrainResult(gaussians, metrics, record.history, scene)
