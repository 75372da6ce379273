"""Adam over Gaussians whose number changes: parameters, moments, statistics, exact state."""

from __future__ import annotations

import dataclasses
import functools
import math
import threading
from collections.abc import Callable
from typing import Any, Concatenate, ParamSpec, TypeVar

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.gaussians import Gaussians, order_by_morton_code, press_surfels
from gsut.optimize.arrays import copy_rows, read_rows, to_mask_bytes
from gsut.optimize.atoms import sum_scale_gradients, to_atoms

# Adam's beta 1, beta 2 and epsilon, as in 3DGS.
ADAM = (0.9, 0.999, 1e-15)
# Factor by which the capacity grows at least: copies then cost a constant time a row.
_GROWTH = 1.5
_SETS = ("params", "moment1", "moment2")  # names of `arrays` in a state
_STATISTICS = ("gradient_max", "gradient_sum", "seen", "error_sum")
_Optimizer = TypeVar("_Optimizer")
_Words = ParamSpec("_Words")
_Found = TypeVar("_Found")


def allow_one_thread(
    change: Callable[Concatenate[_Optimizer, _Words], _Found],
) -> Callable[Concatenate[_Optimizer, _Words], _Found]:
    """Wraps a function so that one thread at a time runs it on its first argument, an optimizer.

    Raises:
        InputError: another thread is using the optimizer; results would depend on their order.
    """

    @functools.wraps(change)
    def run_alone(optimizer: _Optimizer, *words: _Words.args, **named: _Words.kwargs) -> _Found:
        turn = optimizer._turn  # type: ignore[attr-defined]
        if not turn.acquire(blocking=False):
            raise InputError(
                f"{change.__name__}: another thread is using this optimizer; give each its own"
            )
        try:
            return change(optimizer, *words, **named)
        finally:
            turn.release()

    return run_alone


@dataclasses.dataclass(frozen=True)
class LearningRates:
    """Learning rates of one step.

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
    """The parameters of a run with their Adam moments and densification statistics.

    Arrays hold `capacity` rows, of which the first `size` are in use; they grow when densification
    needs more. The same calls give the same bits on any number of threads, and after
    `load_state_dict(state_dict())`. One Python thread at a time may call it; a second one gets an
    InputError.

    Args:
        gaussians: the start, copied to float32.
        capacity: rows to reserve, at least len(gaussians); the final number avoids all copies.
        seed: 0 to 2^64 - 1; random numbers of densification and noise depend on it and on `steps`.
        surfels: keep Gaussians flat: the third scale gets no gradient and stays that of a surfel.
        atoms: keep Gaussians round: their three scales are one number.

    Attributes:
        steps: Adam steps made.
        size: number of Gaussians.
        fields: names of the arrays.
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
        atoms: bool = False,
    ) -> None:
        if atoms:
            gaussians = to_atoms(gaussians)
        if surfels and not gaussians.are_surfels:
            gaussians = gaussians.to_surfels()
        size = len(gaussians)
        capacity = size if capacity is None else capacity
        if capacity < size:
            raise InputError(f"capacity is {capacity}, but there are {size} Gaussians")
        self.steps, self.seed, self.surfels, self.atoms = 0, seed, surfels, atoms
        self._turn = threading.RLock()
        params = copy_rows(gaussians.to_dtype(np.float32), size, capacity)
        self.fields = params.list_arrays()
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

    @allow_one_thread
    def step(
        self,
        grads: Any,
        rates: LearningRates,
        visible: np.ndarray | None = None,
        active_sh_degree: int | None = None,
        harmonics: bool = True,
    ) -> None:
        """Makes one Adam step in place.

        Args:
            grads: gradients as arrays means, quats, log_scales, opacity_logits, sh in the shapes of
                the parameters (float32 is not copied).
            rates: learning rates of this step.
            visible: (N,) bool or uint8; rows with 0 keep parameters and moments (sparse Adam).
                None: all rows are stepped.
            active_sh_degree: harmonics above this degree stay; None: all are stepped.
            harmonics: False leaves them out, because the backward pass has stepped them (see
                `prepare_harmonics_step`).

        Raises:
            InputError: shapes disagree.
        """
        names = [name for name in self.fields if harmonics or name != "sh"]
        gradients = [np.ascontiguousarray(getattr(grads, name), np.float32) for name in names]
        for name, gradient in zip(names, gradients, strict=True):
            expected = getattr(self.gaussians, name).shape
            if gradient.shape != expected:
                raise InputError(
                    f"gradient of {name} must have shape {expected}, found {gradient.shape}"
                )
        if self.surfels:
            gradients[names.index("log_scales")][:, 2] = 0
        if self.atoms:
            sum_scale_gradients(gradients[names.index("log_scales")])
        params, moment1, moment2 = ([getattr(rows, name) for name in names] for rows in self.arrays)
        of_columns, columns = _list_columns(self.gaussians, names, rates, active_sh_degree)
        _core.adam_step(
            params, gradients, moment1, moment2, of_columns, self.steps + 1, self.size,
            to_mask_bytes(visible), columns, *ADAM,
        )  # fmt: skip
        self.steps += 1
        self._press()

    def prepare_harmonics_step(
        self, rates: LearningRates, active_sh_degree: int | None = None
    ) -> Any:
        """Prepares the next step of the harmonics, for the backward pass of `gaussians` to make.

        Gradients of harmonics are then never stored, and only rows that a pixel saw are stepped.
        `step` must follow, with those rows as `visible` and without harmonics.
        """
        params, moment1, moment2 = (rows.sh[: self.size] for rows in self.arrays)
        of_columns = _list_harmonics_rates(params, rates, active_sh_degree)
        return _core.HarmonicsStep(params, moment1, moment2, of_columns, self.steps + 1, *ADAM)

    @allow_one_thread
    def add_regularizer(
        self, grads: Any, opacity_weight: float = 0.01, scale_weight: float = 0.01
    ) -> None:
        """Adds the gradient of MCMC's regularisers to `grads`, in place.

        Args:
            grads: float32 arrays opacity_logits (N,) and log_scales (N, 3), as for step.
            opacity_weight, scale_weight: of mean(opacity) and mean(scale in world units); the
                defaults are the paper's.
        """
        _core.mcmc_regularize(
            self.arrays[0], self.size, grads.opacity_logits, grads.log_scales, opacity_weight,
            scale_weight,
        )  # fmt: skip

    @allow_one_thread
    def add_noise(self, rate_means: float, noise_scale: float = 5e5) -> None:
        """Adds MCMC's exploration noise to the means, mainly at opacities below about 0.1.

        Args:
            rate_means: the current learning rate of the means, world units.
            noise_scale: the paper's factor.
        """
        _core.mcmc_noise(self.arrays[0], self.size, rate_means, noise_scale, self.seed, self.steps)

    @allow_one_thread
    def accumulate(
        self, grad_means: np.ndarray, distances: np.ndarray, visible: np.ndarray | None = None
    ) -> None:
        """Adds one view to the statistics for densification.

        Args:
            grad_means: (N, 3) float32, dL/dmean.
            distances: (N,) float32, from the camera centre, world units.
            visible: (N,) bool or uint8; rows with 0 are left out. None: all rows count.
        """
        _core.accumulate_density(
            np.ascontiguousarray(grad_means, np.float32),
            np.ascontiguousarray(distances, np.float32), to_mask_bytes(visible), self.gradient_max,
            self.gradient_sum, self.seen,
        )  # fmt: skip

    @property
    def moments(self) -> tuple[Gaussians, Gaussians]:
        """Adam's first and second moments as views, as `gaussians`."""
        return self.arrays[1][: self.size], self.arrays[2][: self.size]

    @allow_one_thread
    def restart_with(self, gaussians: Gaussians) -> GaussianOptimizer:
        """Returns an optimizer of other Gaussians, drawn as these, that keeps counting steps."""
        gaussians = dataclasses.replace(gaussians, **self.arrays[0].rule)
        new = GaussianOptimizer(gaussians, seed=self.seed, surfels=self.surfels, atoms=self.atoms)
        new.steps = self.steps
        return new

    @allow_one_thread
    def reset_opacities(self, max_opacity: float = 0.01) -> None:
        """Lowers all opacities to at most max_opacity and zeroes their moments (3DGS)."""
        _core.reset_opacities(*self.arrays, self.size, max_opacity)

    @allow_one_thread
    def state_dict(self) -> dict[str, np.ndarray]:
        """Returns copies of everything later calls depend on, as arrays for `np.savez`."""
        state = {
            f"{prefix}.{name}": getattr(rows, name)[: self.size].copy()
            for prefix, rows in zip(_SETS, self.arrays, strict=True)
            for name in self.fields
        }
        for name in _STATISTICS:
            state[name] = getattr(self, name).copy()
        state["steps"] = np.array(self.steps, np.int64)
        state["seed"] = np.array(self.seed, np.uint64)
        return state

    @allow_one_thread
    def load_state_dict(self, state: dict[str, np.ndarray]) -> None:
        """Restores the state of `state_dict`, to the bit; the capacity stays or grows.

        Raises:
            InputError: an array is missing or shapes disagree.
        """
        sets, size = _read_state(state, self.arrays)
        capacity = max(self.capacity, size)
        self.arrays, self.size = sets, size
        self._set_capacity(capacity)
        self.resize(size)
        for name in _STATISTICS:
            getattr(self, name)[:] = state[name]
        self.steps, self.seed = int(state["steps"]), int(state["seed"])

    @allow_one_thread
    def reserve(self, rows: int) -> None:
        """Makes room for `rows` Gaussians."""
        if rows > self.capacity:
            self._set_capacity(max(rows, int(_GROWTH * self.capacity)))

    @allow_one_thread
    def sort_by_place(self) -> None:
        """Sorts all rows along a Z curve, so that the rows of a tile lie close in memory."""
        order = order_by_morton_code(np.nan_to_num(self.gaussians.means))
        for rows in self.arrays:
            for name in self.fields:
                array = getattr(rows, name)
                array[: self.size] = array[order]
        for name in _STATISTICS:
            setattr(self, name, getattr(self, name)[order])

    @allow_one_thread
    def resize(self, size: int) -> None:
        """Sets the number of Gaussians and resets their statistics."""
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


def _read_state(
    state: dict[str, np.ndarray], like: tuple[Gaussians, Gaussians, Gaussians]
) -> tuple[tuple[Gaussians, Gaussians, Gaussians], int]:
    """Reads parameters and moments of a state, and their number of rows.

    Raises:
        InputError: an array is missing or shapes disagree.
    """
    fields = like[0].list_arrays()
    needed = [f"{prefix}.{name}" for prefix in _SETS for name in fields]
    for name in (*needed, *_STATISTICS, "steps", "seed"):
        if name not in state:
            raise InputError(f"the optimizer state has no {name}")
    params, moment1, moment2 = (
        read_rows(rows, {name: state[f"{prefix}.{name}"] for name in fields})
        for prefix, rows in zip(_SETS, like, strict=True)
    )
    sizes = {len(rows) for rows in (params, moment1, moment2)}
    sizes |= {len(state[name]) for name in _STATISTICS}
    if len(sizes) != 1:
        raise InputError(f"the optimizer state has different lengths: {sorted(sizes)}")
    return (params, moment1, moment2), sizes.pop()


def _list_columns(
    gaussians: Gaussians, names: list[str], rates: LearningRates, degree: int | None
) -> tuple[list[list[float]], list[int]]:
    """Lists, for each array, the rates of its columns (one for all alike) and how many step."""
    of_columns = [[getattr(rates, name)] if name != "sh" else [] for name in names]
    columns = [math.prod(getattr(gaussians, name).shape[1:]) for name in names]
    if "sh" in names:
        at = names.index("sh")
        of_columns[at] = _list_harmonics_rates(gaussians.sh, rates, degree)
        columns[at] = len(of_columns[at])
    return of_columns, columns


def _list_harmonics_rates(sh: np.ndarray, rates: LearningRates, degree: int | None) -> list[float]:
    """Lists a rate for each number of a row of harmonics (N, K, 3) that is stepped."""
    coefficients = sh.shape[1] if degree is None else min(sh.shape[1], (degree + 1) ** 2)
    return [rates.sh0] * 3 + [rates.sh_rest] * (3 * (coefficients - 1))
