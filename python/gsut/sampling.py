"""Some of many: how many show what all do, and which are taken."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np

ENOUGH_SAMPLES = 20_000  # for a median, or a share to a percent: more take longer
MAJORITY = 0.5  # share from which most agree, or are the same
FEWEST_SAMPLES = 30  # of which a median is trusted
ENOUGH_PICTURES = 16  # that show what all pictures of a camera or a scene have in common

_T = TypeVar("_T")


def choose_evenly(values: Sequence[_T], most: int = ENOUGH_PICTURES) -> list[_T]:
    """Chooses at most `most` of some values, evenly spread, first and last among them."""
    places = np.linspace(0, len(values) - 1, min(len(values), most)).round().astype(int)
    return [values[place] for place in places]
