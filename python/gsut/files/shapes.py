"""Checks that values of a file, as JSON or YAML gives them, have the types that are read."""

from __future__ import annotations

import dataclasses
import math
from typing import Any


@dataclasses.dataclass(frozen=True)
class Number:
    """The shape of a finite number, or of a list of them.

    Attributes:
        least, most: bounds.
        whole: no fraction; 3.0 is whole.
        shape: of nested lists: the length of each, None for any; (): one number.
    """

    least: float = -math.inf
    most: float = math.inf
    whole: bool = False
    shape: tuple[int | None, ...] = ()

    def is_met_by(self, value: Any) -> bool:
        """Returns whether a value has this shape."""
        return self._is_met_by(value, self.shape)

    def _is_met_by(self, value: Any, shape: tuple[int | None, ...]) -> bool:
        if shape:
            right = isinstance(value, list) and shape[0] in (None, len(value))
            return right and all(self._is_met_by(entry, shape[1:]) for entry in value)
        if not is_number(value) or not self.least <= value <= self.most:
            return False
        return not self.whole or value == math.floor(value)


def is_number(value: Any) -> bool:
    """Returns whether a value is a finite number, and neither true nor false."""
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def check_shape(value: Any, shape: Any, name: str = "the content") -> None:
    """Checks that JSON values have a shape.

    Args:
        value: as JSON gives it.
        shape: a type, where numbers must be finite; a `Number`; a frozenset of strings, of which
            the value is one; {key: shape} of an object, whose other keys are free, where a key
            ending in "?" may be absent and "*" stands for every key; [shape] of a list of any
            length; or a tuple of shapes, of which one fits.
        name: of the value, for the error.

    Raises:
        TypeError: says what is not as it should be.
    """
    fits = True
    if isinstance(shape, tuple):
        fits = any(_has_shape(value, each) for each in shape)
    elif isinstance(shape, Number):
        fits = shape.is_met_by(value)
    elif isinstance(shape, frozenset):
        fits = isinstance(value, str) and value in shape
    elif isinstance(shape, type):
        fits = isinstance(value, shape) and (shape not in (int, float) or is_number(value))
    elif not isinstance(value, type(shape)):
        fits = False
    elif isinstance(shape, list):
        for number, entry in enumerate(value):
            check_shape(entry, shape[0], f"{name}[{number}]")
    else:
        for key, inner in shape.items():
            found = value if key == "*" else {key.rstrip("?")} & value.keys()
            if not found and not key.endswith(("?", "*")):
                raise TypeError(f"{name} lacks {key!r}")
            for each in found:
                check_shape(value[each], inner, f"{name}[{each!r}]")
    if not fits:
        raise TypeError(f"{name} is {value!r:.40}")


def _has_shape(value: Any, shape: Any) -> bool:
    try:
        check_shape(value, shape)
    except TypeError:
        return False
    return True
