"""Families of scenes: each file has functions that build one from a seed, found here by name."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from lab.proving.families import indoors, objects, outdoors
from lab.proving.paints import Style
from lab.proving.stage import Stage

Family = Callable[[np.random.Generator, Style], Stage]

FAMILIES: dict[str, Family] = {
    name.removeprefix("build_"): function
    for module in (indoors, objects, outdoors)
    for name, function in vars(module).items()
    if name.startswith("build_")
}
