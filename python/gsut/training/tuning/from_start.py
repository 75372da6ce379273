"""Trains a small number of Gaussians from the start in place of a compaction, for the same work."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np

from gsut import _core
from gsut.data import Scene
from gsut.render import Light
from gsut.run import TrainOptions
from gsut.run.options import compute_recipe
from gsut.training.first import choose_first_gaussians, leave_out_blurred, limit_gaussians
from gsut.training.loop import TrainingLoop
from gsut.training.photograph import GAINS_DIFFER
from gsut.training.time_left import measure_megapixels, predict_training_steps
from gsut.training.tuning.finetuning import finetune_options

# Name of this way in metrics.json.
FROM_START = "from_start"
# Share of the Gaussians up to which compacting and fine-tuning beats training from the start, even
# if the light of the photographs changes.
_FEW_KEPT = 0.2
# Work of a compaction by ghap for each training view, in steps at full size and number.
_COMPACTION = 5.5
# Rounds after which the number of steps has settled to within one.
_ROUNDS = 4


def is_better_from_start(
    options: TrainOptions, light: Light | None, own: int, count: int, finetune: int
) -> bool:
    """Returns whether training `count` Gaussians from the start beats compacting a run's `own` to
    them.

    Args:
        options: of the run; those of a fine-tuning grow nothing.
        light: of the photographs, if the run has found it.
        own: number of the run's Gaussians.
        count: number to keep.
        finetune: steps that would follow the compaction; 0 means that no photograph may be used.
    """
    if not finetune or light is None or options.densify_every > options.steps:
        return False
    differs = np.log(light.gains).std(axis=0).max() > GAINS_DIFFER  # as "auto" of --exposure
    return bool(differs) and _FEW_KEPT * own < count < own


def train_from_start(
    scene: Scene,
    options: TrainOptions,
    own: int,
    count: int,
    finetune: int,
    light: Light,
    on_step: Callable[[TrainingLoop, float], object] = lambda loop, loss: None,
) -> TrainingLoop:
    """Trains `count` Gaussians with a run's options, for the work of the run and its compaction.

    Args:
        scene: at the resolution to train at, with the poses that the run has refined.
        options: of the run.
        own: number of the run's Gaussians.
        count: how many to train, at most.
        finetune: steps that would follow the compaction, whose work counts, too.
        light: of the photographs.
        on_step: called after each step with the loop and the step's loss.

    Returns:
        The finished loop. The number of steps is found by a rule and no clock, so that the bits are
        the same on any number of threads.
    """
    _core.set_num_threads(options.threads)
    scene = leave_out_blurred(scene, options)
    start, _ = choose_first_gaussians(scene, limit_gaussians(options, count))
    chosen = options_from_start(scene, options, len(start), own, count, finetune)
    loop = TrainingLoop(scene, chosen, start, light=light)
    while loop.step < chosen.steps:
        on_step(loop, loop.advance())
    return loop


def options_from_start(
    scene: Scene, options: TrainOptions, first: int, own: int, count: int, finetune: int
) -> TrainOptions:
    """Returns options whose steps are as much work as the run, its compaction and fine-tuning.

    Args:
        first: number of the first Gaussians.
        scene, options, own, count, finetune: see `train_from_start`.
    """
    megapixels = measure_megapixels(scene)

    def sum_work(o: TrainOptions, begin: int) -> float:
        # The exact sum, rounded once, is the same on every machine.
        return math.fsum(predict_training_steps(o, begin, megapixels))

    compaction = round(_COMPACTION * len(scene.train_indices))
    whole, few = limit_gaussians(options, own), limit_gaussians(options, count)
    wanted = (
        sum_work(whole, first)
        + sum_work(finetune_options(whole, compaction, own), own)
        + sum_work(finetune_options(few, finetune, count), count)
    )
    chosen = _set_steps(few, options.steps)
    for _ in range(_ROUNDS):
        chosen = _set_steps(few, max(1, round(wanted * chosen.steps / sum_work(chosen, first))))
    return chosen


def _set_steps(options: TrainOptions, steps: int) -> TrainOptions:
    """Changes the number of steps and what the recipe derives from it."""
    before, after = (
        compute_recipe(options.steps, options.sh_degree),
        compute_recipe(steps, options.sh_degree),
    )
    follows = {name: after[name] for name in before if getattr(options, name) == before[name]}
    return dataclasses.replace(
        options, steps=steps, **follows | {"eval_every": 0}, compact_at=None, exposure="on",
        refine_poses=False, refine_lens=False,
    )  # fmt: skip
