"""Fine-tunes a finished set of Gaussians: more steps at a fixed number of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

from gsut import _core
from gsut.data import Scene
from gsut.gaussians import Gaussians
from gsut.render import Light
from gsut.run import TrainOptions
from gsut.training.loop import TrainingLoop

# Learning rates of a fine-tuning: twice those of training, eight times for the harmonics, fixed for
# the centres; all fall to a tenth. Both halving and doubling them gives a worse result.
_RATES: dict[str, Any] = {
    "lr_means": 3.2e-4,
    "lr_scales": 3e-2,
    "lr_quats": 8e-3,
    "lr_opacity": 0.2,
    "lr_sh0": 1.4e-2,
    "lr_sh_rest": 1e-3,
    "lr_final_factor": 0.1,
}


def finetune_options(options: TrainOptions, steps: int, count: int) -> TrainOptions:
    """Returns the options with which `count` Gaussians are fine-tuned.

    Args:
        options: of their run; data, seed, threads and loss are kept.
        steps: of the fine-tuning.
        count: number of Gaussians, which stays.
    """
    return dataclasses.replace(
        options,
        steps=steps,
        max_gaussians=count,
        checkpoint_every=0,
        refine_poses=False,  # read_trained gives the poses that the run has refined
        refine_lens=False,
    )


def finetune(
    scene: Scene,
    gaussians: Gaussians,
    options: TrainOptions,
    on_step: Callable[[TrainingLoop, float], object] = lambda loop, loss: None,
    light: Light | None = None,
) -> tuple[Gaussians, float]:
    """Trains Gaussians on with fresh Adam moments; their number stays.

    Args:
        scene: at the resolution to train at.
        gaussians: the start.
        options: from `finetune_options`.
        on_step: called after each step with the loop and the step's loss.
        light: of the photographs, if the run has found it.

    Returns:
        The Gaussians and the seconds of the steps. The bits do not depend on the
        number of threads.
    """
    _core.set_num_threads(options.threads)
    options = dataclasses.replace(options, exposure="off" if light is None else "on")
    recipe = dataclasses.replace(
        options.recipe, coarse_to_fine=(0.0, 0.0), densify_every=options.steps + 1,  # never
        noise=False, sh_every=1, regularizer=0.0, **_RATES,
    )  # fmt: skip
    loop = TrainingLoop(scene, options, gaussians, light=light, recipe=recipe)
    while loop.step < options.steps:
        on_step(loop, loop.advance())
    return loop.make_result().copy(), loop.seconds
