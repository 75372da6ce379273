"""Adam for a fixed set of Gaussians whose harmonics have different degrees."""

from __future__ import annotations

from typing import Any

import numpy as np

from gsut import _core
from gsut.gaussians import Gaussians, MixedGaussians, press_surfels
from gsut.optimize.arrays import to_mask_bytes
from gsut.optimize.optimizer import ADAM, GaussianOptimizer, LearningRates
from gsut.run.options import FLAT_PRIMITIVES

_GEOMETRY = ("means", "quats", "log_scales", "opacity_logits")
_COLUMNS = [3, 4, 3, 1]


class MixedOptimizer:
    """A `GaussianOptimizer` without densification for `MixedGaussians`; gives the same bits.

    Args:
        gaussians: the start, copied.
        surfels: as for `GaussianOptimizer`; the start must be surfels.

    Attributes:
        gaussians: the parameters after the last step.
        steps: Adam steps made.
    """

    def __init__(self, gaussians: MixedGaussians, surfels: bool = False) -> None:
        self.gaussians = gaussians.copy()
        self.steps, self._surfels = 0, surfels
        self._moments = gaussians.make_zeros(), gaussians.make_zeros()

    def step(
        self,
        grads: MixedGaussians,
        rates: LearningRates,
        visible: np.ndarray | None = None,
        active_sh_degree: int | None = None,
        harmonics: bool = True,
    ) -> None:
        """Makes one Adam step in place, as `GaussianOptimizer.step` does."""
        self.steps += 1
        if self._surfels:
            grads.log_scales[:, 2] = 0
        seen = to_mask_bytes(visible)
        sets = (self.gaussians, grads, *self._moments)
        geometry = [[getattr(arrays, name) for name in _GEOMETRY] for arrays in sets]
        self._step_adam(geometry, [[getattr(rates, name)] for name in _GEOMETRY], seen, _COLUMNS)
        for parts in (
            zip(*(arrays.split_bands() for arrays in sets), strict=True) if harmonics else ()
        ):
            rows, coefficients = parts[0][0], parts[0][1].shape[1]
            if active_sh_degree is not None:
                coefficients = min(coefficients, (active_sh_degree + 1) ** 2)
            of_sh = [rates.sh0] * 3 + [rates.sh_rest] * (3 * (coefficients - 1))
            bands = [[band] for _, band in parts]
            self._step_adam(
                bands, [of_sh], None if seen is None else seen[rows], [3 * coefficients]
            )
        if self._surfels:
            press_surfels(self.gaussians.log_scales)

    def _step_adam(
        self,
        arrays: list[list[np.ndarray]],
        rates: list[list[float]],
        visible: np.ndarray | None,
        columns: list[int],
    ) -> None:
        params, grads, moment1, moment2 = arrays
        _core.adam_step(
            params, grads, moment1, moment2, rates, self.steps, len(params[0]), visible, columns,
            *ADAM,
        )  # fmt: skip

    def add_regularizer(self, grads: Any, opacity_weight: float, scale_weight: float) -> None:
        """Adds the gradient of MCMC's regularisers, as `GaussianOptimizer.add_regularizer` does."""
        if opacity_weight == 0 and scale_weight == 0:
            return
        g = self.gaussians
        no_sh = np.zeros((len(g), 1, 3), np.float32)
        plain = Gaussians(g.means, g.quats, g.log_scales, g.opacity_logits, no_sh)
        _core.mcmc_regularize(
            plain, len(g), grads.opacity_logits, grads.log_scales, opacity_weight, scale_weight
        )

    def accumulate(
        self, grad_means: np.ndarray, distances: np.ndarray, visible: np.ndarray | None = None
    ) -> None:
        """Does nothing: statistics serve densification only."""


def make_optimizer(start: Any, capacity: int | None, seed: int, primitive: str = "gaussian") -> Any:
    """Makes the optimizer that fits `start`: `Gaussians`, or `MixedGaussians`, which do not grow.

    Args:
        start: copied.
        capacity, seed: used for `Gaussians` only, see `GaussianOptimizer`.
        primitive: as in `TrainOptions`: flat ones stay flat, atoms round.
    """
    surfels, atoms = primitive in FLAT_PRIMITIVES, primitive == "atom"
    if isinstance(start, MixedGaussians) and not atoms:
        return MixedOptimizer(start, surfels)
    if isinstance(start, MixedGaussians):
        start = start.to_gaussians()
    return GaussianOptimizer(start, capacity, seed=seed, surfels=surfels, atoms=atoms)
