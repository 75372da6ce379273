"""Fine-tuning of a finished set of Gaussians: more steps at a fixed number of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

from gsut import _core
from gsut.data.scene import Scene
from gsut.gaussians import Gaussians
from gsut.options import TrainOptions
from gsut.train import TrainingLoop

# Rates as in training, but for the centres' start and the ends: the others fall to a tenth. No
# regularisers, no noise, full resolution, all harmonics from the first step. sponza_fisheye merged
# from 500 000 to 50 000, 500 steps: 34.34 dB; centres at 4.8e-4 34.28, at 1.2e-3 33.27; others to
# 3 % 34.13; with the regularisers 0.04 less; with the training recipe as it is 32.77.
_RATES: dict[str, Any] = {"lr_means": 1.6e-4, "lr_final_factor": 0.1}


def finetune_options(options: TrainOptions, steps: int, count: int) -> TrainOptions:
    """The options that `count` Gaussians are fine-tuned with.

    Args:
        options: of the run that they come from; data, seed, threads and loss are kept.
        steps: of the fine-tuning.
        count: number of Gaussians, which stays.
    """
    return dataclasses.replace(
        options,
        steps=steps,
        max_gaussians=max(count, options.init_count or 1),
        eval_every=0,
        checkpoint_every=0,
        coarse_to_fine=(0.0, 0.0),
        densify_every=steps + 1,  # never
        noise=False,
        sh_every=1,
        compact_at=None,
        opacity_regularizer=0.0,
        scale_regularizer=0.0,
        **_RATES,
    ).resolved()


def finetune(
    scene: Scene,
    gaussians: Gaussians,
    options: TrainOptions,
    on_step: Callable[[TrainingLoop, float], object] = lambda loop, loss: None,
) -> tuple[Gaussians, float]:
    """Trains Gaussians on with fresh Adam moments; their number stays.

    Args:
        scene: at the resolution to train at.
        gaussians: the start.
        options: from `finetune_options`.
        on_step: called after each step with the loop and the step's loss.

    Returns:
        The Gaussians and the seconds of the steps. The same bits on any number of threads.
    """
    _core.set_num_threads(options.threads)
    loop = TrainingLoop(scene, options, gaussians)
    while loop.step < options.steps:
        on_step(loop, loop.advance())
    return loop.result().copy(), loop.seconds
