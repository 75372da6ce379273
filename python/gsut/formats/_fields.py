"""Reads the fields of a file's description, each checked against what it may be."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.bounds import show


@dataclasses.dataclass(frozen=True)
class Fields:
    """The fields of one JSON object.

    Args:
        path: of the file, for messages.
        values: the object.
        name: of the object, for messages, such as "accessors[3]"; empty: the file's whole.
    """

    path: Path
    values: Any
    name: str = ""

    def __post_init__(self) -> None:
        if not isinstance(self.values, dict):
            raise self._refuse("", self.values, "an object in braces")

    def read_fields(self, key: str, index: int | None = None) -> Fields:
        """Reads the object of this name, or the entry `index` of a list of objects."""
        place = f"{self.name}.{key}" if self.name else key
        if index is None:
            return Fields(self.path, self.values.get(key), place)
        entries = self.values.get(key)
        if not isinstance(entries, list) or not 0 <= index < len(entries):
            raise self._refuse(key, entries, f"a list with an entry {index}")
        return Fields(self.path, entries[index], f"{place}[{index}]")

    def read_whole(
        self, key: str, low: int, high: float = math.inf, default: int | None = None
    ) -> int:
        """Reads a whole number from `low` to `high`; without a default it has to be there."""
        value = self.values.get(key, default)
        whole = isinstance(value, (int, float)) and not isinstance(value, bool)
        if not whole or not low <= value <= high or value % 1:
            limits = f"from {low} to {high}" if high < math.inf else f"of at least {low}"
            raise self._refuse(key, value, f"a whole number {limits}")
        return int(value)

    def read_numbers(self, key: str, least: int, most: int) -> np.ndarray:
        """Reads a list of `least` to `most` finite numbers, as float64."""
        values = self.values.get(key)
        count = f"{least} to {most}" if least < most else f"{least}"
        good = isinstance(values, list) and least <= len(values) <= most
        if not good or not all(
            isinstance(v, (int, float)) and not isinstance(v, bool) and math.isfinite(v)
            for v in values
        ):
            raise self._refuse(key, values, f"a list of {count} finite numbers")
        return np.array(values, np.float64)

    def read_names(self, key: str, count: int) -> list[str]:
        """Reads a list of this many different names."""
        names = self.values.get(key)
        good = isinstance(names, list) and all(isinstance(name, str) for name in names)
        if not good or not len(names) == len(set(names)) == count:
            raise self._refuse(key, names, f"a list of {count} different names")
        return names

    def require(self, key: str, allowed: Any = None) -> None:
        """Raises InputError if the field is there and is not the one value that gsut reads."""
        if key in self.values and self.values[key] != allowed:
            what = "gsut does not read it" if allowed is None else f"gsut reads only {allowed!r}"
            found = show(repr(self.values[key]))
            raise InputError(f"{self.path}: {self.name}.{key} is {found}; {what}")

    def _refuse(self, key: str, value: Any, wanted: str) -> InputError:
        place = ".".join(filter(None, (self.name, key))) or "its description"
        shown = "missing" if value is None else show(repr(value))
        return InputError(f"{self.path}: damaged: {place} is {shown}, and has to be {wanted}")
