"""Defines what strategies of densification have in common, and loads one by its name."""

from __future__ import annotations

import dataclasses
import importlib
from typing import Any

from gsut.data import Scene
from gsut.optimize import GaussianOptimizer
from gsut.run import TrainOptions
from gsut.run.options import Recipe


@dataclasses.dataclass(frozen=True)
class DensificationStep:
    """When a densification takes place, and on what.

    Attributes:
        step: of the run, from 1.
        fraction: of all steps.
        scene: at the current resolution.
        extent: of the scene in world units.
    """

    step: int
    fraction: float
    scene: Scene
    extent: float


class Densification:
    """A strategy: the base of the class `Strategy` in each file of training/strategies.

    Args:
        options, recipe: of the run.
        first_count: number of the first Gaussians.

    Attributes:
        by_error: whether the errors of the pixels that show a Gaussian decide, too.
    """

    by_error = False

    def __init__(self, options: TrainOptions, recipe: Recipe, first_count: int) -> None:
        self.options, self.recipe, self.first_count = options, recipe, first_count

    @property
    def capacity(self) -> int | None:
        """The number of rows to reserve in the optimizer's arrays; None: one for each Gaussian."""
        return None

    def add_gradients(self, optimizer: Any, gradients: Any) -> None:
        """Adds the gradients of the strategy's own losses, before Adam's step."""

    def explore(self, optimizer: Any, rate_means: float) -> None:
        """Moves Gaussians at random, after Adam's step.

        Args:
            optimizer: owner of the Gaussians.
            rate_means: learning rate of the centres in world units.
        """

    def densify(self, optimizer: GaussianOptimizer, now: DensificationStep) -> GaussianOptimizer:
        """Adds and removes Gaussians; returns the optimizer to continue with."""
        raise NotImplementedError

    def settle(self, optimizer: GaussianOptimizer, now: DensificationStep) -> None:
        """Replaces `densify`, at the same intervals, after `DENSIFY_UNTIL`."""


def load_strategy(options: TrainOptions, recipe: Recipe, first_count: int) -> Densification:
    """Loads the strategy that `options` names."""
    module = importlib.import_module(f"gsut.training.strategies.{options.strategy}")
    return module.Strategy(options, recipe, first_count)
