"""The settings of `gsut.scene` and the command `gsut scene`."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from gsut.run.options.fields import (
    check_options,
    define_option,
    describe_options,
    list_fields,
    list_words,
)
from gsut.run.options.recipe import PRESETS


@describe_options
@dataclasses.dataclass(frozen=True)
class SceneOptions:
    """All settings of `gsut.scene`; immutable, checked when made.

    Raises:
        InputError: a value of the wrong kind or out of range (names option, value and range).
    """

    # fmt: off
    preset: str = define_option(
        "balanced", "Training", "how long to train; see `gsut train --help`",
        choices=tuple(PRESETS),
    )
    steps: int | None = define_option(
        None, "Training", "training steps, one picture each", low=1, high=10_000_000,
        none="the preset's",
    )
    camera: str | None = define_option(
        None, "Camera", "lens file, or the camera's name, such as 'GoPro HERO9 Black, Max Wide' "
        "(see `gsut camera find`)",
        none="what the pictures say of their camera; otherwise the lens is estimated",
    )
    fov: float | None = define_option(
        None, "Camera", "rough horizontal field of view", unit="degrees", low=0, low_open=True,
        high=360, none="estimated",
    )
    frames: int | None = define_option(
        None, "Pictures", "number of frames to choose from a video", low=1,
        none="60 to 300, depending on how far the view moves",
    )
    nadir_cap: float = define_option(
        0.0, "Pictures", "360-degree pictures: mask everything within this angle of straight down "
        "(tripod, hand, selfie stick)", unit="degrees", low=0, high=90,
    )
    keep_all_pixels: bool = define_option(
        False, "Pictures", "see `gsut poses --help`",
    )
    # fmt: on

    def __post_init__(self) -> None:
        check_options(self)

    @classmethod
    def from_key(cls, key: Mapping[str, Any]) -> SceneOptions:
        """Returns the settings among the values of a scene's key."""
        return cls(**{f.name: key[f.name] for f in list_fields(cls) if f.name in key})

    def list_words(self, *but: str) -> list[str]:
        """Lists the words of a command line that make these options, without the fields `but`."""
        return list_words(self, SceneOptions(), but)
