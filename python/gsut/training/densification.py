"""How Gaussians are added and removed in training: what each strategy has in common."""

from __future__ import annotations

import dataclasses
import importlib
from typing import Any

from gsut.data import Scene
from gsut.optimize import GaussianOptimizer
from gsut.run import TrainOptions


@dataclasses.dataclass(frozen=True)
class DensificationStep:
    """When a densification takes place, and on what.

    Attributes:
        step: of the run; fraction: of all steps.
        scene: at the resolution that is trained at now.
        extent: of the scene, world units.
        full_grown: the number of Gaussians is to stay.
    """

    step: int
    fraction: float
    scene: Scene
    extent: float
    full_grown: bool


class Densification:
    """A strategy: one file of training/strategies, whose class `Strategy` derives from this one.

    Args:
        options: resolved.
        first_count: number of the first Gaussians.

    Attributes:
        by_error: it goes by the errors of the pixels that a Gaussian is seen in, too.
    """

    by_error = False

    def __init__(self, options: TrainOptions, first_count: int) -> None:
        self.options, self.first_count = options, first_count

    def capacity(self) -> int | None:
        """Rows of the optimizer's arrays to reserve; None: as many as there are Gaussians."""
        return None

    def add_gradients(self, optimizer: Any, gradients: Any) -> None:
        """Before Adam's step: adds gradients of the strategy's own losses."""

    def explore(self, optimizer: Any, rate_means: float) -> None:
        """After Adam's step, with the learning rate of the means in world units."""

    def densify(self, optimizer: GaussianOptimizer, now: DensificationStep) -> GaussianOptimizer:
        """Adds and removes Gaussians; returns the optimizer to go on with."""
        raise NotImplementedError

    def settle(self, optimizer: GaussianOptimizer, now: DensificationStep) -> None:
        """As often, once nothing is added or removed any more."""


def densification_of(options: TrainOptions, first_count: int) -> Densification:
    """The strategy that the options name."""
    module = importlib.import_module(f"gsut.training.strategies.{options.strategy}")
    return module.Strategy(options, first_count)
