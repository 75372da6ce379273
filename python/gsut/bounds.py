"""Bounds of the numbers that people, pages and programs give: the same ones at every door."""

from __future__ import annotations

import math
import operator
from typing import Any

import numpy as np

from gsut._core import InputError

# Largest whole number without a limit of its own: it becomes a 32-bit integer.
MOST_WHOLE = 2**31 - 1
# Largest number without a limit of its own: its square is finite.
MOST = 1e100
# Farthest coordinate in any unit: the Earth is 1e10 millimetres wide.
FARTHEST = 1e12
# Least scale of a scene: from the size of an atom to a building's; float32 ends at 1e38.
LEAST_SCALE = 1e-12


def check_number(
    value: Any,
    name: str,
    low: float | None = None,
    high: float | None = None,
    *,
    whole: bool = False,
    above: bool = False,
) -> Any:
    """Returns a number as int or float if it lies within bounds.

    Args:
        value: the number, or text that is one.
        name: of the number, for the error; "" says the range alone.
        low, high: allowed both; None: as far as squares are finite, or 32-bit integers go.
        whole: without digits behind the point.
        above: `low` itself is not allowed.

    Raises:
        InputError: it is no such number; NaN never is.
    """
    most = MOST_WHOLE if whole else MOST
    low, high = -most if low is None else low, most if high is None else high
    try:
        if isinstance(value, str):
            number = int(value) if whole else float(value)
        else:
            number = operator.index(value) if whole else float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    is_inside = number > low if above else number >= low
    if not (is_inside and number <= high):
        end = f"above {low:.10g}, up" if above else f"from {low:.10g}"
        kind = f"a {'whole ' if whole else ''}number {end} to {high:.10g}"
        if not whole and not math.isfinite(number):
            kind = "a finite number"
        raise InputError(f"{name} takes {kind}, found {str(value)[:80]!r}".strip())
    return number


def check_vector(values: Any, name: str) -> np.ndarray:
    """Returns (3,) float64 of coordinates, or raises InputError."""
    try:
        vector = np.array(values, np.float64)
    except (TypeError, ValueError, OverflowError):
        vector = np.zeros(0)
    if vector.shape != (3,) or not (np.abs(vector) <= FARTHEST).all():
        raise InputError(f"{name} takes 3 numbers, of at most {FARTHEST:g}, found {values!s:.80}")
    return vector


def check_direction(values: Any, name: str) -> np.ndarray:
    """Returns a direction (3,) of length 1, or raises InputError."""
    vector = check_vector(values, name)
    length = float(np.linalg.norm(vector))
    if length < 1 / FARTHEST:
        raise InputError(f"{name} must be a direction, found {values!s:.80}")
    return vector / length
