"""Options of a preset, fitted to a scene: what the user has given stays."""

from __future__ import annotations

import dataclasses
from typing import Any

from gsut.run.options import TrainOptions
from gsut.run.recipe import preset_values

# Below so many training views a preset's steps are as many fewer, down to the least: more gain
# nothing from so few (docs/performance.md).
_FULL_STEPS_VIEWS, _LEAST_STEPS = 25, 500


def is_open(options: TrainOptions, name: str) -> bool:
    """Whether the preset has given a value, and not the user."""
    return name in options._open


def of_preset(options: TrainOptions, name: str) -> Any:
    """The value that the preset has for any scene."""
    return preset_values(options.preset)[name]


def for_views(options: TrainOptions, views: int) -> TrainOptions:
    """The same options for so many training views: where the preset gives the steps, fewer."""
    steps = of_preset(options, "steps")
    return _with(options, steps=min(steps, max(_LEAST_STEPS, steps * views // _FULL_STEPS_VIEWS)))


def for_degree(options: TrainOptions, degree: int) -> TrainOptions:
    """The same options with harmonics of this degree, where the preset gives one that is lower."""
    return _with(options, sh_degree=max(degree, of_preset(options, "sh_degree")))


def _with(options: TrainOptions, **values: Any) -> TrainOptions:
    """With these values where they are open, as they then remain."""
    changed = dataclasses.replace(
        options, **{name: value for name, value in values.items() if is_open(options, name)}
    )
    object.__setattr__(changed, "_open", options._open)
    return changed
