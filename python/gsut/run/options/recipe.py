"""What a training does that depends on the preset or on the number of steps."""

from __future__ import annotations

import dataclasses
import itertools
import math
from typing import Any

# Values a preset gives to options that are not given; max_gaussians is the limit of "auto". Size
# and Gaussians fit together: "fast" has as many pixels for each Gaussian as "balanced", since
# detail finer than the Gaussians can hold costs time and gains nothing.
PRESETS: dict[str, dict[str, Any]] = {
    "fast": {"steps": 500, "max_gaussians": 50_000, "sh_degree": 1, "max_side": 800},
    "balanced": {"steps": 2000, "max_gaussians": 200_000, "sh_degree": 1, "max_side": 1600},
    "best": {"steps": 7000, "max_gaussians": 300_000, "sh_degree": 2, "max_side": 1600},
}

# Learning rate of the centres x steps, as (steps, product): what counts is how far centres can
# move in the whole run, so short runs need higher rates.
_MEANS_LR_TIMES_STEPS = ((500, 1.3), (1000, 0.8))
# Range of that rate, in scene extents a step: long runs keep the rate that suits 2000 steps.
_MEANS_LR_RANGE = (4.8e-4, 3.2e-3)
# Learning rate of the logarithms of the scales, as (steps, rate).
_SCALES_LR = ((500, 2e-2), (1000, 1.5e-2))
# Learning rate of harmonics above degree 0 x steps, for the same reason as for the centres.
_SH_REST_LR_TIMES_STEPS = 1.0
# Range of that rate; the lower end is the published rate.
_SH_REST_LR_RANGE = (1.25e-4, 1e-3)
# Decay of the other rates, as (steps, factor at the last step): short runs have no time to settle.
_LR_FINAL_FACTOR = ((1000, 1.0), (2000, 0.5), (7000, 0.3))
# Steps between relocations, as (steps, interval).
_DENSIFY_EVERY = ((1000, 50.0), (2000, 100.0))
# Relocations in a run that is shorter than the table above, at least.
_FEWEST_DENSIFICATIONS = 10
# Fractions of the steps until which to train at 1/4 and at 1/2 of the resolution.
_QUARTER_UNTIL = ((1000, 0.20), (2000, 0.15), (7000, 0.075))
_HALF_UNTIL = ((1000, 0.45), (2000, 0.40), (7000, 0.20))
# MCMC noise explores, which only pays in runs of at least this many steps.
_NOISE_FROM_STEPS = 1500
# All harmonics are in use after this fraction of the steps.
_SH_WITHIN = 0.6
# Most steps between two degrees of harmonics: the published interval.
_SH_EVERY_MOST = 1000
# Largest cap under which a training grows beyond it: Gaussians that fill it do not die, so none
# moves to where detail is missing.
_SMALL_CAP = 20_000
# Number of Gaussians under a small cap before they are merged, x the cap.
_OVERGROWTH = 2.0
# Fewest steps of a training that has time to settle after the merging.
_OVERGROWTH_FROM_STEPS = 400


@dataclasses.dataclass(frozen=True)
class Recipe:
    """What a training of a number of steps does and no option sets.

    Rates are those of the first step; each falls by its factor until the last one.

    Attributes:
        coarse_to_fine: fractions of the steps until which to train at 1/4 and at 1/2 of the size.
        densify_every: steps between densifications.
        sh_every: steps between two degrees of harmonics.
        noise: whether MCMC adds noise to the centres.
        overgrowth: most Gaussians of a new training, x the cap that they are merged to.
        regularizer: weights of the mean opacity and of the mean scale in the loss (MCMC).
        lr_means: of the centres, x scene extent; `lr_means_final_factor` is their factor.
        lr_scales, lr_quats, lr_opacity, lr_sh0, lr_sh_rest: of the logarithms of scales, rotations,
            opacity logits, base colour and other harmonics; `lr_final_factor` is the factor of them
            all.
    """

    coarse_to_fine: tuple[float, float]
    densify_every: int
    sh_every: int
    noise: bool
    lr_means: float
    lr_scales: float
    lr_sh_rest: float
    lr_final_factor: float
    overgrowth: float = 1.0
    lr_quats: float = 4e-3  # 4 x published
    lr_opacity: float = 0.1  # 2 x published
    lr_sh0: float = 7e-3  # 3 x published
    lr_means_final_factor: float = 0.01  # published
    regularizer: float = 0.01  # published (MCMC)


def make_recipe(steps: int, sh_degree: int, cap: int | None = None) -> Recipe:
    """Makes the recipe of a training.

    Args:
        steps: number of them.
        sh_degree: degree of the harmonics.
        cap: most Gaussians; None: they cannot be merged, so must not outgrow it.
    """
    overgrows = cap is not None and cap <= _SMALL_CAP and steps >= _OVERGROWTH_FROM_STEPS
    densify_every = round(_interpolate(steps, _DENSIFY_EVERY))
    return Recipe(
        coarse_to_fine=(_interpolate(steps, _QUARTER_UNTIL), _interpolate(steps, _HALF_UNTIL)),
        densify_every=max(1, min(densify_every, steps // _FEWEST_DENSIFICATIONS)),
        sh_every=max(1, min(_SH_EVERY_MOST, round(_SH_WITHIN * steps / (sh_degree + 1)))),
        noise=steps >= _NOISE_FROM_STEPS,
        lr_means=_clamp(_interpolate(steps, _MEANS_LR_TIMES_STEPS) / steps, _MEANS_LR_RANGE),
        lr_scales=_interpolate(steps, _SCALES_LR),
        lr_sh_rest=_clamp(_SH_REST_LR_TIMES_STEPS / steps, _SH_REST_LR_RANGE),
        lr_final_factor=_interpolate(steps, _LR_FINAL_FACTOR),
        overgrowth=_OVERGROWTH if overgrows else 1.0,
    )


def get_preset(preset: str | None) -> dict[str, Any]:
    """Returns the values that a preset gives; None means "balanced"."""
    return PRESETS[preset or "balanced"]


def _clamp(value: float, ends: tuple[float, float]) -> float:
    return min(max(value, ends[0]), ends[1])


def _interpolate(steps: int, table: tuple[tuple[int, float], ...]) -> float:
    """Returns the value at `steps`, linear in log(steps) between rows and constant outside."""
    if steps <= table[0][0]:
        return table[0][1]
    for (s0, v0), (s1, v1) in itertools.pairwise(table):
        if steps <= s1:
            t = math.log(steps / s0) / math.log(s1 / s0)
            return v0 + t * (v1 - v0)
    return table[-1][1]
