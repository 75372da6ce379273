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


@dataclasses.dataclass(frozen=True)
class FromStart:
    """A training from the start in place of a compaction.

    Attributes:
        options: of the run; those of a fine-tuning grow nothing.
        own: number of the run's Gaussians.
        count: number to keep, the most to train.
        finetune: steps that would follow the compaction; 0 means that no photograph may be used.
        light: of the photographs, if the run has found it.
    """

    options: TrainOptions
    own: int
    count: int
    finetune: int
    light: Light | None

    def is_better(self) -> bool:
        """Returns whether this training beats compacting the run's Gaussians."""
        if not self.finetune or self.light is None:
            return False
        if self.options.densify_every > self.options.steps:
            return False
        # The criterion of `exposure` "auto".
        differs = np.log(self.light.gains).std(axis=0).max() > GAINS_DIFFER
        return bool(differs) and _FEW_KEPT * self.own < self.count < self.own

    def train(self, scene: Scene, on_step: Callable[[TrainingLoop, float], object]) -> TrainingLoop:
        """Trains with the run's options, for the work of the run and its compaction.

        Args:
            scene: at the resolution to train at, with the poses that the run has refined.
            on_step: called after each step with the loop and the step's loss.

        Returns:
            The finished loop. The number of steps follows from a rule and no clock, so that the
            bits are the same on any number of threads.
        """
        _core.set_num_threads(self.options.threads)
        scene = leave_out_blurred(scene, self.options)
        start, _ = choose_first_gaussians(scene, limit_gaussians(self.options, self.count))
        chosen = self.choose_options(scene, len(start))
        loop = TrainingLoop(scene, chosen, start, light=self.light)
        while loop.step < chosen.steps:
            on_step(loop, loop.advance())
        return loop

    def choose_options(self, scene: Scene, first: int) -> TrainOptions:
        """Returns options whose steps are as much work as the run, its compaction and fine-tuning.

        Args:
            scene: as it is trained on.
            first: number of the first Gaussians.
        """
        megapixels = measure_megapixels(scene)

        def sum_work(o: TrainOptions, begin: int) -> float:
            # The exact sum, rounded once, is the same on every machine.
            return math.fsum(predict_training_steps(o, begin, megapixels))

        own, count = self.own, self.count
        compaction = round(_COMPACTION * len(scene.train_indices))
        whole, few = (limit_gaussians(self.options, most) for most in (own, count))
        wanted = (
            sum_work(whole, first)
            + sum_work(finetune_options(whole, compaction, own), own)
            + sum_work(finetune_options(few, self.finetune, count), count)
        )
        chosen = _set_steps(few, self.options.steps)
        for _ in range(_ROUNDS):
            steps = max(1, round(wanted * chosen.steps / sum_work(chosen, first)))
            chosen = _set_steps(few, steps)
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
