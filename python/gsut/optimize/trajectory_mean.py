"""The mean of the Gaussians over the last steps of training: the result of a run.

Each step pulls the Gaussians towards one photograph. Where photographs differ in more than the
point of view (exposure, white balance, a shadow), the last step's Gaussians are those of the last
few photographs; their mean over some epochs is nearer to all (stochastic weight averaging,
Izmailov et al., 2018). It costs one pass over the parameters every few steps.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from gsut.gaussians import Gaussians, press_surfels

# Fraction of the steps after which states are averaged: the mean over the last tenth is steadier.
_FROM = 0.9
# Steps between averaged states: consecutive ones hardly differ, and each costs a pass.
_EVERY = 4


class TrajectoryMean:
    """Running mean of all parameters: quaternions and logarithms as they are optimised.

    Args:
        surfels: keep the mean flat.
    """

    def __init__(self, surfels: bool = False) -> None:
        self._surfels = surfels
        self._mean: Gaussians | None = None
        self._count = 0

    def observe(self, step: int, fraction: float, gaussians: Gaussians) -> None:
        """Adds the state after a step, if it is due.

        Args:
            step: from 1.
            fraction: of all steps.
            gaussians: of the optimiser; copied.
        """
        if fraction <= _FROM or step % _EVERY:
            return
        if self._mean is None or len(self._mean) != len(gaussians):
            self._mean, self._count = gaussians.copy(), 1
            return
        self._count += 1
        for name in gaussians.list_arrays():
            mean = getattr(self._mean, name)
            mean += (getattr(gaussians, name) - mean) * np.float32(1 / self._count)
        if self._surfels:
            press_surfels(self._mean.log_scales)

    def restart(self) -> None:
        """Forgets all states, because rows have become other Gaussians."""
        self._mean, self._count = None, 0

    def average(self, gaussians: Gaussians) -> Gaussians:
        """Returns the mean, or `gaussians` if no state was averaged since the last restart."""
        return gaussians if self._mean is None else self._mean

    def state_dict(self) -> dict[str, Any]:
        """Returns the mean and the number of states in it."""
        if self._mean is None:
            return {"count": 0}
        known = {name: value for name, value in vars(self._mean).items() if value is not None}
        return {"count": self._count, **known}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restores the state of `state_dict`."""
        self.restart()
        arrays = {name: value for name, value in state.items() if name != "count"}
        self._count = int(state["count"])
        if self._count:
            self._mean = Gaussians(**arrays).copy()
