"""Kinds and bounds of what people, pages and programs give: the same ones at every door."""

from __future__ import annotations

import builtins
import collections.abc
import functools
import inspect
import math
import numbers
import operator
import os
import types
import typing
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

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

_P = ParamSpec("_P")
_R = TypeVar("_R")


def show(value: Any) -> str:
    """Shows what was found, for an error: one short line."""
    return " ".join(str(value).split())[:80]


def name_wrong_kinds(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Makes a public function's errors name an argument of a wrong kind.

    Where Python's own error comes from inside, the arguments are compared with the annotations;
    an error that has another reason stays.
    """

    @functools.wraps(function)
    def call(*given: _P.args, **named: _P.kwargs) -> _R:
        try:
            return function(*given, **named)
        except (TypeError, AttributeError, OverflowError) as error:
            # Names that are imported for type checkers alone become Any.
            known: list[dict[str, Any]] = [function.__globals__, vars(builtins)]
            known.append(collections.defaultdict(lambda: Any))
            hints = typing.get_type_hints(function, localns=collections.ChainMap(*known))
            for name, value in inspect.signature(function).bind(*given, **named).arguments.items():
                if name in hints and not _is_of_kind(value, hints[name]):
                    raise InputError(
                        f"{name} must be {_describe(hints[name])}, found {show(value)} "
                        f"({type(value).__name__})"
                    ) from error
            raise

    return call


def _is_of_kind(value: Any, hint: Any) -> bool:
    """Returns whether a value is of an annotation's kind; True where that cannot be seen."""
    if hint is Any:  # a class from Python 3.11 on
        return True
    origin, parts = typing.get_origin(hint) or hint, typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        return any(_is_of_kind(value, part) for part in parts)
    if origin is np.ndarray:
        try:
            array = np.asarray(value)
        except ValueError:  # rows of several lengths
            return False
        return array.ndim > 0 and array.dtype.kind in "biuf"
    if origin in _NUMBERS:
        return isinstance(value, _NUMBERS[origin])
    if not isinstance(origin, type) or getattr(origin, "_is_protocol", False):
        return True
    if origin is not collections.abc.Sequence:
        return isinstance(value, origin)
    is_listed = isinstance(value, (collections.abc.Sequence, np.ndarray))
    is_listed = is_listed and not isinstance(value, (str, bytes))
    return is_listed and all(_is_of_kind(each, parts[0]) for each in value)


def _describe(hint: Any) -> str:
    """Describes an annotation's kind in words."""
    origin, parts = typing.get_origin(hint) or hint, typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        return " or ".join(_describe(part) for part in parts)
    if origin is collections.abc.Sequence:
        return f"a list, of {_describe(parts[0])} each"
    return _WORDS.get(origin, getattr(origin, "__name__", str(origin)))


_NUMBERS = {int: numbers.Integral, float: numbers.Real}
_WORDS = {
    int: "a whole number", float: "a number", str: "text", np.ndarray: "an array of numbers",
    type(None): "None", os.PathLike: "a path",
}  # fmt: skip


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
        raise InputError(f"{name} takes 3 numbers, of at most {FARTHEST:g}, found {show(values)}")
    return vector


def check_direction(values: Any, name: str) -> np.ndarray:
    """Returns a direction (3,) of length 1, or raises InputError."""
    vector = check_vector(values, name)
    length = float(np.linalg.norm(vector))
    if length < 1 / FARTHEST:
        raise InputError(f"{name} must be a direction, found {show(values)}")
    return vector / length
