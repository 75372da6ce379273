"""As few Gaussians trained from the start in place of a compaction, for the same work."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np

from gsut import _core
from gsut.data import Scene
from gsut.render import Light
from gsut.run import TrainOptions, recipe
from gsut.training.complexity import with_most
from gsut.training.finetuning import finetune_options
from gsut.training.loop import TrainingLoop
from gsut.training.photograph_model import DIFFER
from gsut.training.start import first_gaussians, without_blurred
from gsut.training.time_left import measure_megapixels, predict_training_steps

FROM_START = "from_start"  # the name in metrics.json
# Up to this share compacting and fine-tuning was better than training as few from the start, on all
# captures tried; above, not where light changes (fox: 0.6 dB at 0.3; docs/results.md).
_FEW_KEPT = 0.2
# A compaction by ghap takes as long as so many steps at full size and number for each training view
# (fox at 1/8 5.8, sponza at 1/2 5.0). From the start then took 1.0 to 1.1 times the seconds.
_COMPACTION = 5.5
_ROUNDS = 4  # after which the number of steps does not change any more, or by one


def is_better_from_start(
    options: TrainOptions, light: Light | None, own: int, count: int, finetune: int
) -> bool:
    """Whether training `count` Gaussians from the start beats compacting a run's `own` to them.

    Args:
        options: of the run; those of a fine-tuning grow nothing.
        light: of the photographs, if the run has found it.
        finetune: steps that would follow the compaction; without any no photograph is to be used.
    """
    if not finetune or light is None or options.densify_every > options.steps:
        return False
    differs = np.log(light.gains).std(axis=0).max() > DIFFER  # as "auto" of --exposure
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
    scene = without_blurred(scene, options)
    start, _ = first_gaussians(scene, with_most(options, count))
    chosen = options_from_start(scene, options, len(start), own, count, finetune)
    loop = TrainingLoop(scene, chosen, start, light=light)
    while loop.step < chosen.steps:
        on_step(loop, loop.advance())
    return loop


def options_from_start(
    scene: Scene, options: TrainOptions, first: int, own: int, count: int, finetune: int
) -> TrainOptions:
    """Of so many steps that they are as much work as the run, its compaction and fine-tuning.

    Args:
        first: number of the first Gaussians.
        scene, options, own, count, finetune: see `train_from_start`.
    """
    megapixels = measure_megapixels(scene)

    def work(o: TrainOptions, begin: int) -> float:
        # The exact sum, rounded once, is the same on every machine.
        return math.fsum(predict_training_steps(o, begin, megapixels))

    compaction = round(_COMPACTION * len(scene.train_indices))
    whole, few = with_most(options, own), with_most(options, count)
    wanted = (
        work(whole, first)
        + work(finetune_options(whole, compaction, own), own)
        + work(finetune_options(few, finetune, count), count)
    )
    chosen = _with_steps(few, options.steps)
    for _ in range(_ROUNDS):
        chosen = _with_steps(few, max(1, round(wanted * chosen.steps / work(chosen, first))))
    return chosen


def _with_steps(options: TrainOptions, steps: int) -> TrainOptions:
    """The options for so many steps: what the recipe gives for a number of steps follows it."""
    before, after = recipe(options.steps, options.sh_degree), recipe(steps, options.sh_degree)
    follows = {name: after[name] for name in before if getattr(options, name) == before[name]}
    return dataclasses.replace(
        options, steps=steps, **follows | {"eval_every": 0}, compact_at=None, exposure="on",
        refine_poses=False, refine_lens=False,
    )  # fmt: skip
