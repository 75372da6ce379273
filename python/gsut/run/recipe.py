"""The recipe: presets, and values of training options that depend on how many steps there are."""

from __future__ import annotations

import itertools
import math
from typing import Any

# Values a preset gives where the user gives none; its max_gaussians is the most that auto takes.
PRESETS: dict[str, dict[str, Any]] = {
    "fast": {"steps": 500, "max_gaussians": 50_000, "sh_degree": 1},
    "balanced": {"steps": 2000, "max_gaussians": 200_000, "sh_degree": 1},
    "best": {"steps": 7000, "max_gaussians": 300_000, "sh_degree": 2},
}

# The rate of the means times the number of steps is what matters; from 1667 steps on the rate stays
# at the value measured as best for 2000 and more. (Steps, rate x steps): 0.8 at 500 steps, too,
# costs 0.1 to 0.4 dB.
_MEANS_LR_TIMES_STEPS = ((500, 1.3), (1000, 0.8))
_MEANS_LR_RANGE = (4.8e-4, 3.2e-3)  # the upper end is extrapolated, not measured
_SCALES_LR = ((500, 2e-2), (1000, 1.5e-2))
# Of harmonics above degree 0, likewise: 3e-3 at 500 steps costs sponza 0.26 dB, 1.25e-4 fox 0.4.
_SH_REST_LR_TIMES_STEPS = 1.0
_SH_REST_LR_RANGE = (1.25e-4, 1e-3)  # the lower end is the published rate
# Decay of the other rates, (steps, factor at the last step): none in short runs.
_LR_FINAL_FACTOR = ((1000, 1.0), (2000, 0.5), (7000, 0.3))
# Steps between relocations: 50 in the short recipe, 100 in the medium one.
_DENSIFY_EVERY = ((1000, 50.0), (2000, 100.0))
# Until which fraction of the steps to train at 1/4 and 1/2 of the resolution.
_QUARTER_UNTIL = ((1000, 0.20), (2000, 0.15), (7000, 0.075))
_HALF_UNTIL = ((1000, 0.45), (2000, 0.40), (7000, 0.20))
# Steps between measurements of the held-out PSNR, at least: four views take as long as ten steps.
_EVAL_EVERY_LEAST = 100
_GROW_UNTIL = 0.5  # fraction of the steps until which Gaussians grow
_NOISE_FROM_STEPS = 1500  # noise gained nothing at 500 and 1000 steps, 0.17 dB at 2000
_SH_WITHIN = 0.6  # all harmonics are in use after this fraction of the steps (degree 1: half of it)
_SH_EVERY_MOST = 1000  # the published interval


def recipe(steps: int, sh_degree: int) -> dict[str, Any]:
    """Name of an option -> its value where it is not given."""
    densify_every = round(_at_steps(steps, _DENSIFY_EVERY))
    return {
        "eval_every": max(steps // 10, min(steps, _EVAL_EVERY_LEAST)),
        "lr_means": _within(_at_steps(steps, _MEANS_LR_TIMES_STEPS) / steps, _MEANS_LR_RANGE),
        "lr_scales": _at_steps(steps, _SCALES_LR),
        "lr_sh_rest": _within(_SH_REST_LR_TIMES_STEPS / steps, _SH_REST_LR_RANGE),
        "lr_final_factor": _at_steps(steps, _LR_FINAL_FACTOR),
        "sh_every": max(1, min(_SH_EVERY_MOST, round(_SH_WITHIN * steps / (sh_degree + 1)))),
        # At least ten times in a run that is shorter than the recipes.
        "densify_every": max(1, min(densify_every, steps // 10)),
        "noise": steps >= _NOISE_FROM_STEPS,
        "grow_until": _GROW_UNTIL,
        "coarse_to_fine": (_at_steps(steps, _QUARTER_UNTIL), _at_steps(steps, _HALF_UNTIL)),
    }


def preset_values(preset: str | None) -> dict[str, Any]:
    """Name of an option -> what the preset gives; no preset means "balanced"."""
    return PRESETS[preset or "balanced"]


def _within(value: float, ends: tuple[float, float]) -> float:
    return min(max(value, ends[0]), ends[1])


def _at_steps(steps: int, table: tuple[tuple[int, float], ...]) -> float:
    """Value at `steps`, linear in log(steps) between the table's rows, constant outside."""
    if steps <= table[0][0]:
        return table[0][1]
    for (s0, v0), (s1, v1) in itertools.pairwise(table):
        if steps <= s1:
            t = math.log(steps / s0) / math.log(s1 / s0)
            return v0 + t * (v1 - v0)
    return table[-1][1]
