"""Adam over Gaussians whose number changes: parameters, moments, statistics, exact state."""

from __future__ import annotations

import dataclasses
import functools
import threading
from collections.abc import Callable
from typing import Any, Concatenate, ParamSpec, TypeVar

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.gaussians import Gaussians, are_surfels, order_by_morton_code, press_surfels, to_surfels
from gsut.optimize.arrays import FIELDS, copy_rows, mask_bytes

ADAM = (0.9, 0.999, 1e-15)  # beta 1, beta 2 and epsilon of 3DGS
_GROWTH = 1.5  # of the capacity, when it has to grow
_SETS = ("params", "moment1", "moment2")  # names of `arrays` in a state
_STATISTICS = ("gradient_max", "gradient_sum", "seen", "error_sum")
_Optimizer = TypeVar("_Optimizer")
_Words = ParamSpec("_Words")
_Found = TypeVar("_Found")


def alone(
    change: Callable[Concatenate[_Optimizer, _Words], _Found],
) -> Callable[Concatenate[_Optimizer, _Words], _Found]:
    """What reads or changes all of an optimizer, its first argument: one thread at a time.

    Raises:
        InputError: another thread is at it; in which order they came would be left to chance.
    """

    @functools.wraps(change)
    def guarded(optimizer: _Optimizer, *words: _Words.args, **named: _Words.kwargs) -> _Found:
        turn = optimizer._turn  # type: ignore[attr-defined]
        if not turn.acquire(blocking=False):
            raise InputError(
                f"{change.__name__}: another thread is at work on this optimizer; give each its own"
            )
        try:
            return change(optimizer, *words, **named)
        finally:
            turn.release()

    return guarded


@dataclasses.dataclass(frozen=True)
class LearningRates:
    """One step's learning rates.

    Args:
        means: of the centres, world units.
        quats: of the rotations.
        log_scales: of the logarithms of the scales.
        opacity_logits: of the opacities' logits.
        sh0: of the constant coefficient of the harmonics.
        sh_rest: of the other coefficients.
    """

    means: float
    quats: float
    log_scales: float
    opacity_logits: float
    sh0: float
    sh_rest: float


class GaussianOptimizer:
    """Owns the parameters of a run, their Adam moments and densification statistics.

    Arrays hold `capacity` rows, of which the first `size` are alive; they grow when densification
    needs it. The same calls give the same bits on any number of threads, and after
    load_state_dict(state_dict()). It belongs to one Python thread at a time: another that calls it
    meanwhile gets an InputError.

    Args:
        gaussians: the start, copied to float32.
        capacity: rows to reserve, at least len(gaussians); give the final number to never copy.
        seed: of densification and noise, 0 to 2^64 - 1; their numbers depend on it and on `steps`.
        surfels: the third scale has no gradient and is that of surfels after each call.

    Attributes:
        steps: Adam steps made.
        size: number of Gaussians.
        arrays: parameters and Adam's first and second moments, `capacity` rows each.
        gradient_max: (N,) largest |dL/dmean| x distance since the last densification.
        gradient_sum: (N,) sum of half of it.
        seen: (N,) number of views in that sum.
        error_sum: (N,) sum over views and pixels of blend weight x the pixel's error since then.

    Raises:
        InputError: the capacity is too small.
    """

    def __init__(
        self,
        gaussians: Gaussians,
        capacity: int | None = None,
        *,
        seed: int = 0,
        surfels: bool = False,
    ) -> None:
        if surfels and not are_surfels(gaussians):
            gaussians = to_surfels(gaussians)
        size = len(gaussians)
        capacity = size if capacity is None else capacity
        if capacity < size:
            raise InputError(f"capacity is {capacity}, but there are {size} Gaussians")
        self.steps, self.seed, self.surfels = 0, seed, surfels
        self._turn = threading.RLock()
        params = copy_rows(gaussians.to_dtype(np.float32), size, capacity)
        moments = copy_rows(params, 0, capacity), copy_rows(params, 0, capacity)
        self.arrays: tuple[Gaussians, Gaussians, Gaussians] = (params, *moments)
        self.resize(size)

    @property
    def capacity(self) -> int:
        """Rows that fit without copying."""
        return len(self.arrays[0])

    @property
    def gaussians(self) -> Gaussians:
        """The Gaussians as views (no copy) that follow each step, until densification."""
        return self.arrays[0][: self.size]

    @alone
    def step(
        self,
        grads: Any,
        rates: LearningRates,
        visible: np.ndarray | None = None,
        active_sh_degree: int | None = None,
        harmonics: bool = True,
    ) -> None:
        """One Adam step in place.

        Args:
            grads: gradients as arrays means, quats, log_scales, opacity_logits, sh in the shapes of
                the parameters (float32 is not copied).
            rates: learning rates of this step.
            visible: (N,) bool or uint8; rows with 0 keep parameters and moments (sparse Adam).
                None: all rows are stepped.
            active_sh_degree: harmonics above it are not touched; None: all are stepped.
            harmonics: False leaves them out, as the backward pass took their `harmonics_step`.

        Raises:
            InputError: shapes disagree.
        """
        names = FIELDS if harmonics else FIELDS[:-1]
        gradients = [np.ascontiguousarray(getattr(grads, name), np.float32) for name in names]
        for name, gradient in zip(names, gradients, strict=True):
            expected = getattr(self.gaussians, name).shape
            if gradient.shape != expected:
                raise InputError(
                    f"gradient of {name} must have shape {expected}, found {gradient.shape}"
                )
        if self.surfels:
            gradients[FIELDS.index("log_scales")][:, 2] = 0
        params, moment1, moment2 = ([getattr(rows, name) for name in names] for rows in self.arrays)
        of_columns = [[getattr(rates, name)] for name in FIELDS[:-1]]
        of_columns.append(_harmonics_rates(self.gaussians.sh, rates, active_sh_degree))
        columns = [3, 4, 3, 1, len(of_columns[-1])]
        _core.adam_step(
            params, gradients, moment1, moment2, of_columns[: len(names)], self.steps + 1,
            self.size, mask_bytes(visible), columns[: len(names)], *ADAM,
        )  # fmt: skip
        self.steps += 1
        self._press()

    def harmonics_step(self, rates: LearningRates, active_sh_degree: int | None = None) -> Any:
        """The next step's part for the harmonics, which a backward pass of `gaussians` may take.

        Their gradients are then written nowhere, and only rows that a pixel saw are stepped.
        `step` has to follow, with those rows as `visible` and without harmonics.
        """
        params, moment1, moment2 = (rows.sh[: self.size] for rows in self.arrays)
        of_columns = _harmonics_rates(params, rates, active_sh_degree)
        return _core.HarmonicsStep(params, moment1, moment2, of_columns, self.steps + 1, *ADAM)

    @alone
    def add_regularizer(
        self, grads: Any, opacity_weight: float = 0.01, scale_weight: float = 0.01
    ) -> None:
        """Adds the gradient of MCMC's regularisers to `grads`, in place.

        Args:
            grads: float32 arrays opacity_logits (N,) and log_scales (N, 3), as for step.
            opacity_weight, scale_weight: of mean(opacity) and mean(scale in world units); defaults:
                the paper's.
        """
        _core.mcmc_regularize(
            self.arrays[0], self.size, grads.opacity_logits, grads.log_scales, opacity_weight,
            scale_weight,
        )  # fmt: skip

    @alone
    def add_noise(self, rate_means: float, noise_scale: float = 5e5) -> None:
        """Adds MCMC's exploration noise to the means; it matters for opacities below about 0.1.

        Args:
            rate_means: the present learning rate of the means, world units.
            noise_scale: the paper's factor.
        """
        _core.mcmc_noise(self.arrays[0], self.size, rate_means, noise_scale, self.seed, self.steps)

    @alone
    def accumulate(
        self, grad_means: np.ndarray, distances: np.ndarray, visible: np.ndarray | None = None
    ) -> None:
        """Gathers one view's statistics for densification.

        Args:
            grad_means: (N, 3) float32, dL/dmean.
            distances: (N,) float32, from the camera centre, world units.
            visible: (N,) bool or uint8; rows with 0 are left out. None: all count.
        """
        _core.accumulate_density(
            np.ascontiguousarray(grad_means, np.float32),
            np.ascontiguousarray(distances, np.float32), mask_bytes(visible), self.gradient_max,
            self.gradient_sum, self.seen,
        )  # fmt: skip

    @property
    def moments(self) -> tuple[Gaussians, Gaussians]:
        """Adam's first and second moments as views, as `gaussians`."""
        return self.arrays[1][: self.size], self.arrays[2][: self.size]

    @alone
    def restarted(self, gaussians: Gaussians) -> GaussianOptimizer:
        """An optimizer of other Gaussians, with moments of 0, that goes on counting steps."""
        new = GaussianOptimizer(gaussians, seed=self.seed, surfels=self.surfels)
        new.steps = self.steps
        return new

    @alone
    def reset_opacities(self, max_opacity: float = 0.01) -> None:
        """Lowers all opacities to at most max_opacity and zeroes their moments (3DGS)."""
        _core.reset_opacities(*self.arrays, self.size, max_opacity)

    @alone
    def state_dict(self) -> dict[str, np.ndarray]:
        """Everything that later calls depend on, as copies of numpy arrays (for np.savez)."""
        state = {
            f"{prefix}.{name}": getattr(rows, name)[: self.size].copy()
            for prefix, rows in zip(_SETS, self.arrays, strict=True)
            for name in FIELDS
        }
        for name in _STATISTICS:
            state[name] = getattr(self, name).copy()
        state["steps"] = np.array(self.steps, np.int64)
        state["seed"] = np.array(self.seed, np.uint64)
        return state

    @alone
    def load_state_dict(self, state: dict[str, np.ndarray]) -> None:
        """Goes on exactly where state_dict was taken; the capacity stays or grows.

        Raises:
            InputError: an array is missing or shapes disagree.
        """
        needed = [f"{prefix}.{name}" for prefix in _SETS for name in FIELDS]
        for name in (*needed, *_STATISTICS, "steps", "seed"):
            if name not in state:
                raise InputError(f"the optimizer state has no {name}")
        params, moment1, moment2 = (
            Gaussians(*(state[f"{prefix}.{name}"] for name in FIELDS)) for prefix in _SETS
        )
        sizes = {len(rows) for rows in (params, moment1, moment2)}
        sizes |= {len(state[name]) for name in _STATISTICS}
        if len(sizes) != 1:
            raise InputError(
                f"the optimizer state has arrays of different lengths: {sorted(sizes)}"
            )
        (size,) = sizes
        capacity = max(self.capacity, size)
        self.arrays, self.size = (params, moment1, moment2), size
        self._set_capacity(capacity)
        self.resize(size)
        for name in _STATISTICS:
            getattr(self, name)[:] = state[name]
        self.steps, self.seed = int(state["steps"]), int(state["seed"])

    @alone
    def reserve(self, rows: int) -> None:
        """Makes room for `rows` Gaussians."""
        if rows > self.capacity:
            self._set_capacity(max(rows, int(_GROWTH * self.capacity)))

    @alone
    def sort_by_place(self) -> None:
        """Brings rows that are near in space together in memory, with all that belongs to them.

        What a tile reads then lies closer together, and a step takes less time.
        """
        order = order_by_morton_code(np.nan_to_num(self.gaussians.means))
        for rows in self.arrays:
            for name in FIELDS:
                array = getattr(rows, name)
                array[: self.size] = array[order]
        for name in _STATISTICS:
            setattr(self, name, getattr(self, name)[order])

    @alone
    def resize(self, size: int) -> None:
        """From here on `size` rows are alive; their statistics begin anew."""
        self.size = size
        self.gradient_max, self.gradient_sum, self.error_sum = np.zeros((3, size), np.float32)
        self.seen = np.zeros(size, np.int32)
        self._press()

    def _press(self) -> None:
        if self.surfels:
            press_surfels(self.gaussians.log_scales)

    def _set_capacity(self, rows: int) -> None:
        params, moment1, moment2 = (copy_rows(old, self.size, rows) for old in self.arrays)
        self.arrays = params, moment1, moment2


def _harmonics_rates(sh: np.ndarray, rates: LearningRates, degree: int | None) -> list[float]:
    """A rate for each number of a row of harmonics (N, K, 3) that is stepped."""
    coefficients = sh.shape[1] if degree is None else min(sh.shape[1], (degree + 1) ** 2)
    return [rates.sh0] * 3 + [rates.sh_rest] * (3 * (coefficients - 1))
