"""Imports public names on first use, so that a command loads only what it needs."""

from __future__ import annotations

import ast
import importlib
import sys
import types
from pathlib import Path
from typing import Any


class _Package(types.ModuleType):
    """A package whose names come from `_homes`: name -> (module, its name there).

    A function may be called as its folder is (`render`, `train`). Python puts a folder into its
    package when it imports it; the function's name stays the function's.
    """

    def __getattr__(self, name: str) -> Any:
        home = self.__dict__["_homes"].get(name)
        if home is not None:
            value = getattr(importlib.import_module(home[0]), home[1])
        else:
            value = self._import_folder(name)
        self.__dict__[name] = value
        return value

    def _import_folder(self, name: str) -> types.ModuleType:
        """Imports a folder of the package on first use."""
        full = f"{self.__name__}.{name}"
        try:
            if not name.startswith("_"):
                return importlib.import_module(full)
        except ModuleNotFoundError as error:
            if error.name != full:
                raise
        raise AttributeError(f"module {self.__name__!r} has no attribute {name!r}")

    def __setattr__(self, name: str, value: Any) -> None:
        if not (isinstance(value, types.ModuleType) and name in self.__dict__["_homes"]):
            super().__setattr__(name, value)

    def __dir__(self) -> list[str]:
        return sorted({*self.__dict__, *self.__dict__["_homes"]})


def import_names(package: str, source: str) -> None:
    """Lets a package import, on first use, the names that its source imports for type checkers.

    Args:
        package: its name.
        source: its file, with these imports below `if TYPE_CHECKING:`.
    """
    tree = ast.parse(Path(source).read_text(encoding="utf-8"))
    homes = {
        alias.asname or alias.name: (line.module, alias.name)
        for block in tree.body
        if isinstance(block, ast.If)
        for line in block.body
        if isinstance(line, ast.ImportFrom)
        for alias in line.names
    }
    module = sys.modules[package]
    module.__dict__["_homes"] = homes
    module.__class__ = _Package
