"""Fine-tuning of a finished set of Gaussians: more steps at a fixed number of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

from gsut import _core
from gsut.data import Scene
from gsut.render import Light
from gsut.run import TrainOptions
from gsut.training.loop import TrainingLoop

# Twice the rates of training, eight times for the harmonics, the centres' by themselves; they fall
# to a tenth. No regularisers, no noise, full resolution, all harmonics from the first step. On
# training views set aside, sponza_fisheye / fox (1/8 size) merged from 200 000 to 20 000 and tuned
# 300 steps: 32.72 / 30.45 dB; the others four times 32.71 / 30.56; twice with centres at 1.6e-4
# and harmonics at 1.25e-4 32.65 / 30.33; so with rates as in training 32.52 / 30.13, half 32.29 /
# 29.88. Moving the 5 % that the loss asks for least to where it asks for most, every 50 steps: 0.1
# dB less.
# At 1000 steps, sponza at half size: these rates 34.86 dB (300 steps 34.52, 2000 steps 35.00), all
# twice 34.69, half 34.75; noise, regularisers and moving the dead 34.85; beginning with 60 or 80 %
# of the number and growing to it by gradients 34.45 and 34.70; the whole model's pictures from
# between the views beside the photographs 34.62 to 34.88; first to 50 %, 200 steps, then to 10 %,
# 800 steps: 34.78; the mean over the last 30 % of the steps in place of 10 %: the same.
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
        refine_poses=False,  # read_trained gives the poses that the run has refined
        refine_lens=False,
        opacity_regularizer=0.0,
        scale_regularizer=0.0,
        **_RATES,
    ).resolved()


def finetune(
    scene: Scene,
    gaussians: Any,
    options: TrainOptions,
    on_step: Callable[[TrainingLoop, float], object] = lambda loop, loss: None,
    light: Light | None = None,
) -> tuple[Any, float]:
    """Trains Gaussians on with fresh Adam moments; their number stays.

    Args:
        scene: at the resolution to train at.
        gaussians: the start; of `MixedGaussians` each keeps its degree of harmonics.
        options: from `finetune_options`.
        on_step: called after each step with the loop and the step's loss.
        light: of the photographs, if the run has found it.

    Returns:
        The Gaussians, of the same kind, and the seconds of the steps. The same bits on any number
        of threads.
    """
    _core.set_num_threads(options.threads)
    options = dataclasses.replace(options, exposure="off" if light is None else "on")
    loop = TrainingLoop(scene, options, gaussians, light=light)
    while loop.step < options.steps:
        on_step(loop, loop.advance())
    return loop.result().copy(), loop.seconds
