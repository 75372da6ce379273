"""Fits the values of a preset to a scene; values that the user has given stay."""

from __future__ import annotations

import dataclasses
from typing import Any

from gsut.run.options.recipe import get_preset
from gsut.run.options.train import TrainOptions

# With fewer training views than this, a preset takes proportionally fewer steps: more gain nothing.
_FULL_STEPS_VIEWS = 25
# Fewest steps of a preset, however few the views.
_LEAST_STEPS = 500
# Share of a preset's steps that takes as long where Gaussians outgrow their cap for a while.
_OVERGROWN_STEPS = 0.9


def is_from_preset(options: TrainOptions, name: str) -> bool:
    """Returns whether the preset, and not the user, gave an option its value."""
    return name in options._open


def get_preset_value(options: TrainOptions, name: str) -> Any:
    """Returns the value that the preset of these options has for any scene."""
    return get_preset(options.preset)[name]


def fit_to_views(options: TrainOptions, views: int) -> TrainOptions:
    """Reduces the steps of a preset for a scene of few training views, or for a small cap."""
    steps = get_preset_value(options, "steps")
    fewer = min(steps, max(_LEAST_STEPS, steps * views // _FULL_STEPS_VIEWS))
    fitted = _replace_open(options, steps=fewer)
    if fitted.recipe.overgrowth == 1.0:
        return fitted
    return _replace_open(options, steps=round(_OVERGROWN_STEPS * fewer))


def raise_degree(options: TrainOptions, degree: int) -> TrainOptions:
    """Raises the degree of a preset's harmonics to `degree` if it is lower."""
    return _replace_open(options, sh_degree=max(degree, get_preset_value(options, "sh_degree")))


def _replace_open(options: TrainOptions, **values: Any) -> TrainOptions:
    """Replaces the values that the preset gave; they count as the preset's afterwards, too."""
    changed = dataclasses.replace(
        options, **{name: value for name, value in values.items() if is_from_preset(options, name)}
    )
    object.__setattr__(changed, "_open", options._open)
    return changed
