"""The whole way from photographs to Gaussians, one line a stage: read this file first."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable
from typing import Any

from gsut import _core
from gsut._core import InputError
from gsut.data import Scene, with_shutter
from gsut.evaluate import run_metrics
from gsut.gaussians import Gaussians
from gsut.run import Progress, TrainOptions
from gsut.training import TrainingLoop, create_run, first_poses, judge, write_results

# Held-out views that the curve of PSNR is measured on: a few, spread evenly.
_CURVE_VIEWS = 8


@dataclasses.dataclass
class TrainResult:
    """What training gives.

    Attributes:
        gaussians: the scene's Gaussians, in the scene's (recentred) coordinates.
        metrics: the content of metrics.json.
        history: one dict a logged step: step, seconds, loss, num_gaussians, psnr.
        scene: at the size trained at, with the poses and lens as they were refined (if asked for).
    """

    gaussians: Gaussians
    metrics: dict[str, Any]
    history: list[dict[str, Any]]
    scene: Scene

    def __repr__(self) -> str:
        psnr = self.metrics["psnr"]
        judged = "" if psnr is None else f", {psnr:.2f} dB on {self.metrics['evaluated_on']}"
        return f"TrainResult({self.gaussians}, {self.metrics['steps']} steps{judged})"


def train(
    scene: Scene,
    options: TrainOptions | None = None,
    *,
    out: str | os.PathLike[str] | None = None,
    resume: bool = False,
    progress: bool | Callable[[dict[str, Any]], None] = True,
) -> TrainResult:
    """Trains Gaussians on a scene's training views; its test views are only measured.

    Args:
        scene: from `load_dataset`.
        options: every setting of the run; None: the defaults.
        out: run folder that gets scene.ply, metrics.json, report.html, checkpoints ...; None: no
            files.
        resume: go on from the checkpoint in `out`, to the same bits as an unbroken run.
        progress: True shows a bar; a function gets each row of the history.

    Returns:
        Gaussians, metrics and history. The same seed gives the same bits on any number of threads.

    Raises:
        InputError: no training view, an option out of range, or `out` holds a run.
    """
    o = (options or TrainOptions()).resolved()
    _core.set_num_threads(o.threads)
    if not scene.train_indices:
        raise InputError(f"{scene.path} has no training view; hold out fewer (--test-every)")
    run = None if out is None else create_run(out, o, scene, resume)
    if o.scale != 1.0:
        scene = scene.scaled(o.scale)
    scene = with_shutter(scene, o.shutter, o.readout_time, o.readout_direction)
    checkpoint = run.load_checkpoint() if run is not None and resume else None
    tracks = None
    if o.refine_poses and o.refine_tracks and checkpoint is None:
        tracks = first_poses(scene, o, progress is True)
    loop = TrainingLoop(scene if tracks is None else tracks.scene, o)
    if loop.refiner is not None and tracks is not None:
        loop.refiner.hold_to(tracks.tracked, tracks.summary())
    if checkpoint is not None:
        loop.load_state_dict(checkpoint[1])
    history = run.read_history() if run is not None else []

    with Progress(progress is True) as bar:
        while loop.step < o.steps:
            loss = loop.advance()
            row = loop.history_row(loss)
            psnr = row.get("psnr") if row else None
            bar.show_step(loop.step, o.steps, loss, len(loop.gaussians), psnr)
            if row:
                history.append(row)
                if run is not None:
                    run.append_history(row)
                if callable(progress):
                    progress(row)
            if run is not None and o.checkpoint_every and loop.step % o.checkpoint_every == 0:
                run.save_checkpoint(loop.step, loop.state_dict())

    if run is not None:
        run.save_checkpoint(loop.step, loop.state_dict())
    gaussians, scene = loop.result().copy(), loop.finished_scene()
    indices = scene.test_indices or scene.train_indices[:_CURVE_VIEWS]
    scene, evaluation = judge(gaussians, scene, indices, o, run)
    metrics = run_metrics(
        evaluation, gaussians, scene, o, steps=loop.step, train_seconds=loop.seconds
    )
    metrics["evaluated_on"] = "test views" if scene.test_indices else "training views"
    if loop.refiner is not None:
        metrics["refinement"] = loop.refiner.figures()
    if run is not None:
        write_results(run, gaussians, metrics, scene if o.refine_poses else None)
    return TrainResult(gaussians, metrics, history, scene)
