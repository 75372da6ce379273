"""Optimisation of Gaussians: Adam, learning rates, densification, exact state for checkpoints."""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.gaussians import Gaussians
from gsut.optimize.arrays import FIELDS, grown, mask

_GROWTH = 1.5  # of the capacity, when it has to grow
_PRUNE, _SPLIT = 1, 3  # actions of an adaptive plan
_LARGEST_LOGIT = 80.0  # exp of it still fits float32


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


class McmcCounts(NamedTuple):
    """What densify_mcmc did."""

    size: int
    relocated: int
    added: int


class AdaptiveCounts(NamedTuple):
    """What densify_adaptive did."""

    size: int
    pruned: int
    cloned: int
    split: int


class GaussianOptimizer:
    """Owns the parameters of a run, their Adam moments and densification statistics.

    Arrays hold `capacity` rows, of which the first `size` are alive; they grow when densification
    needs it. The same calls give the same bits on any number of threads, and after
    load_state_dict(state_dict()).

    Args:
        gaussians: the start, copied to float32.
        capacity: rows to reserve, at least len(gaussians); give the final number to never copy.
        seed: of densification and noise, 0 to 2^64 - 1; their numbers depend on it and on `steps`.
        beta1, beta2, epsilon: Adam's (defaults: 3DGS).

    Attributes:
        steps: Adam steps made.
        gradient_max: (N,) largest |dL/dmean| x distance since the last densification.
        gradient_sum: (N,) sum of half of it.
        seen: (N,) number of views in that sum.

    Raises:
        InputError: the capacity is too small.
    """

    def __init__(
        self,
        gaussians: Gaussians,
        capacity: int | None = None,
        *,
        seed: int = 0,
        beta1: float = 0.9,
        beta2: float = 0.999,
        epsilon: float = 1e-15,
    ) -> None:
        size = len(gaussians)
        capacity = size if capacity is None else capacity
        if capacity < size:
            raise InputError(f"capacity is {capacity}, but there are {size} Gaussians")
        self.steps = 0  # Adam steps made
        self.seed = seed
        self.beta1, self.beta2, self.epsilon = beta1, beta2, epsilon
        self._size = size
        self._params = grown(gaussians.astype(np.float32), size, capacity)
        self._moment1 = grown(self._params, 0, capacity)
        self._moment2 = grown(self._params, 0, capacity)
        self._reset_statistics()

    @property
    def size(self) -> int:
        """Number of Gaussians."""
        return self._size

    @property
    def capacity(self) -> int:
        """Rows that fit without copying."""
        return len(self._params)

    @property
    def gaussians(self) -> Gaussians:
        """The Gaussians as views (no copy) that follow each step, until densification."""
        return self._params[: self._size]

    def step(
        self,
        grads: Any,
        rates: LearningRates,
        visible: np.ndarray | None = None,
        active_sh_degree: int | None = None,
    ) -> None:
        """One Adam step in place.

        Args:
            grads: gradients as arrays means, quats, log_scales, opacity_logits, sh in the shapes of
                the parameters (float32 is not copied).
            rates: learning rates of this step.
            visible: (N,) bool or uint8; rows with 0 keep parameters and moments (sparse Adam).
                None: all rows are stepped.
            active_sh_degree: harmonics above it are not touched; None: all are stepped.

        Raises:
            InputError: shapes disagree.
        """
        coefficients = self._params.sh.shape[1]
        if active_sh_degree is not None:
            coefficients = min(coefficients, (active_sh_degree + 1) ** 2)
        sh_rates = [rates.sh0] * 3 + [rates.sh_rest] * (3 * (coefficients - 1))
        gradients = [np.ascontiguousarray(getattr(grads, name), np.float32) for name in FIELDS]
        for name, gradient in zip(FIELDS, gradients, strict=True):
            expected = getattr(self.gaussians, name).shape
            if gradient.shape != expected:
                raise InputError(
                    f"gradient of {name} must have shape {expected}, found {gradient.shape}"
                )
        _core.adam_step(
            [getattr(self._params, name) for name in FIELDS],
            gradients,
            [getattr(self._moment1, name) for name in FIELDS],
            [getattr(self._moment2, name) for name in FIELDS],
            [*([getattr(rates, name)] for name in FIELDS[:-1]), sh_rates],
            self.steps + 1,
            self._size,
            mask(visible),
            [3, 4, 3, 1, 3 * coefficients],
            self.beta1,
            self.beta2,
            self.epsilon,
        )
        self.steps += 1

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
            self._params,
            self._size,
            grads.opacity_logits,
            grads.log_scales,
            opacity_weight,
            scale_weight,
        )

    def add_noise(self, rate_means: float, noise_scale: float = 5e5) -> None:
        """Adds MCMC's exploration noise to the means; it matters for opacities below about 0.1.

        Args:
            rate_means: the present learning rate of the means, world units.
            noise_scale: the paper's factor.
        """
        _core.mcmc_noise(self._params, self._size, rate_means, noise_scale, self.seed, self.steps)

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
            np.ascontiguousarray(distances, np.float32),
            mask(visible),
            self.gradient_max,
            self.gradient_sum,
            self.seen,
        )

    def densify_mcmc(
        self,
        target_size: int,
        weights: np.ndarray | None = None,
        *,
        dead_opacity: float = 0.005,
        max_scale: float = np.inf,
        split: bool = True,
        split_power: float = 1 / 3,
    ) -> McmcCounts:
        """Relocates dead Gaussians onto living ones and adds new ones the same way.

        Args:
            target_size: Gaussians to have afterwards; if there are more already, none is added.
            weights: (N,) chances of living Gaussians to be copied; None: opacity x the largest
                |dL/dmean| x distance since the last densification.
            dead_opacity: at or below, a Gaussian is dead (as is one with a value that is not
                finite).
            max_scale: world units; a Gaussian with a larger standard deviation is dead.
            split: True spreads the n copies over their parent, scales times n^(-1/3); False puts
                them at the same place with the paper's opacities and scales.
            split_power: with split, a copy's opacity is 1 - (1 - o)^(n^-split_power); 1/3 keeps the
                optical thickness, 1 is the paper's rule.

        Returns:
            Counts; fewer are relocated or added if the living would be copied over 50 times.

        Source: Kheradmand et al., "3D Gaussian splatting as Markov chain Monte Carlo", 2024.
        """
        if weights is None:
            logits = np.clip(self.gaussians.opacity_logits, -_LARGEST_LOGIT, _LARGEST_LOGIT)
            weights = self.gradient_max / (1.0 + np.exp(-logits))
        self._reserve(target_size)
        counts = McmcCounts(
            *_core.mcmc_densify(
                self._params,
                self._moment1,
                self._moment2,
                self._size,
                target_size,
                np.ascontiguousarray(weights, np.float32),
                dead_opacity,
                max_scale,
                split,
                split_power,
                self.seed,
                self.steps,
            )
        )
        self._size = counts.size
        self._reset_statistics()
        return counts

    def densify_adaptive(
        self,
        *,
        clone_scale: float,
        gradient_threshold: float = 2e-4,
        prune_opacity: float = 0.005,
        max_scale: float = np.inf,
        max_gaussians: int | None = None,
    ) -> AdaptiveCounts:
        """Clones or splits Gaussians that the loss pulls at, prunes transparent and huge ones.

        Args:
            clone_scale: world units; larger Gaussians are split in two with scales / 1.6, smaller
                ones copied. 3DGS: 0.01 x extent of the scene.
            gradient_threshold: of the mean |dL/dmean| x distance / 2 over the views that saw it.
            prune_opacity: below it a Gaussian is pruned.
            max_scale: world units; above it a Gaussian is pruned. 3DGS: 0.1 x extent.
            max_gaussians: only the Gaussians with the largest gradients grow beyond it.

        Source: Kerbl et al., "3D Gaussian splatting for real-time radiance field rendering", 2023.
        """
        n = self._size
        plan = _core.plan_adaptive(
            self._params,
            n,
            self.gradient_sum,
            self.seen,
            gradient_threshold,
            clone_scale,
            prune_opacity,
            max_scale,
            0 if max_gaussians is None else max_gaussians,
        )
        return self._apply(plan)

    def split_and_prune(self, split: np.ndarray, prune: np.ndarray) -> AdaptiveCounts:
        """Splits chosen Gaussians in two as densify_adaptive does, and prunes others.

        Args:
            split: (N,) bool.
            prune: (N,) bool; these go, even if they were to be split. The others keep their order.
        """
        actions = np.where(prune, _PRUNE, np.where(split, _SPLIT, 0)).astype(np.uint8)
        return self._apply(_core.AdaptivePlan(actions))

    def restarted(self, gaussians: Gaussians) -> GaussianOptimizer:
        """An optimizer of other Gaussians, with moments of 0, that goes on counting steps."""
        new = GaussianOptimizer(gaussians, seed=self.seed)
        new.steps = self.steps
        return new

    def reset_opacities(self, max_opacity: float = 0.01) -> None:
        """Lowers all opacities to at most max_opacity and zeroes their moments (3DGS)."""
        _core.reset_opacities(self._params, self._moment1, self._moment2, self._size, max_opacity)

    def state_dict(self) -> dict[str, np.ndarray]:
        """Everything that later calls depend on, as copies of numpy arrays (for np.savez)."""
        state = {
            f"{prefix}.{name}": getattr(arrays, name)[: self._size].copy()
            for prefix, arrays in self._array_sets()
            for name in FIELDS
        }
        for name in ("gradient_max", "gradient_sum", "seen"):
            state[name] = getattr(self, name).copy()
        state["steps"] = np.array(self.steps, np.int64)
        state["seed"] = np.array(self.seed, np.uint64)
        state["adam"] = np.array([self.beta1, self.beta2, self.epsilon])
        return state

    def load_state_dict(self, state: dict[str, np.ndarray]) -> None:
        """Goes on exactly where state_dict was taken; the capacity stays or grows.

        Raises:
            InputError: an array is missing or shapes disagree.
        """
        loaded = {}
        for prefix, _ in self._array_sets():
            missing = [name for name in FIELDS if f"{prefix}.{name}" not in state]
            if missing:
                raise InputError(f"the optimizer state has no {prefix}.{missing[0]}")
            loaded[prefix] = Gaussians(*(state[f"{prefix}.{name}"] for name in FIELDS))
        for name in ("gradient_max", "gradient_sum", "seen", "steps", "seed", "adam"):
            if name not in state:
                raise InputError(f"the optimizer state has no {name}")
        sizes = {len(arrays) for arrays in loaded.values()}
        sizes |= {len(state[name]) for name in ("gradient_max", "gradient_sum", "seen")}
        if len(sizes) != 1:
            raise InputError(
                f"the optimizer state has arrays of different lengths: {sorted(sizes)}"
            )
        (size,) = sizes
        capacity = max(self.capacity, size)
        self._params = grown(loaded["params"], size, capacity)
        self._moment1 = grown(loaded["moment1"], size, capacity)
        self._moment2 = grown(loaded["moment2"], size, capacity)
        self._size = size
        self.gradient_max = np.array(state["gradient_max"], np.float32)
        self.gradient_sum = np.array(state["gradient_sum"], np.float32)
        self.seen = np.array(state["seen"], np.int32)
        self.steps = int(state["steps"])
        self.seed = int(state["seed"])
        self.beta1, self.beta2, self.epsilon = (float(value) for value in state["adam"])

    def _array_sets(self) -> tuple[tuple[str, Gaussians], ...]:
        return (
            ("params", self._params),
            ("moment1", self._moment1),
            ("moment2", self._moment2),
        )

    def _reset_statistics(self) -> None:
        # (N,) largest and half the sum of |dL/dmean| x distance, and views, since densification.
        self.gradient_max = np.zeros(self._size, np.float32)
        self.gradient_sum = np.zeros(self._size, np.float32)
        self.seen = np.zeros(self._size, np.int32)

    def _apply(self, plan: Any) -> AdaptiveCounts:
        self._reserve(plan.size_after)
        self._size = _core.apply_adaptive(
            self._params, self._moment1, self._moment2, self._size, plan, self.seed, self.steps
        )
        self._reset_statistics()
        return AdaptiveCounts(self._size, plan.pruned, plan.cloned, plan.split)

    def _reserve(self, rows: int) -> None:
        if rows <= self.capacity:
            return
        capacity = max(rows, int(_GROWTH * self.capacity))
        self._params = grown(self._params, self._size, capacity)
        self._moment1 = grown(self._moment1, self._size, capacity)
        self._moment2 = grown(self._moment2, self._size, capacity)
