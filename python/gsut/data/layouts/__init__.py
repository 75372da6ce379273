"""Layouts of datasets, one file each: a module with a `LAYOUT`; those with a "_" are none."""

from __future__ import annotations

import functools
import importlib
import pkgutil
from collections.abc import Collection
from pathlib import Path

from gsut.data.layouts._layout import Layout


@functools.cache
def layouts() -> tuple[Layout, ...]:
    """All layouts there are, in the order in which they are looked for."""
    names = [module.name for module in pkgutil.iter_modules(__path__)]
    modules = [
        importlib.import_module(f"{__name__}.{name}") for name in names if not name.startswith("_")
    ]
    return tuple(sorted((m.LAYOUT for m in modules), key=lambda layout: layout.rank))


def known_layout(path: Path, but: Collection[str] = ()) -> Layout | None:
    """The first layout, but for those of these names, that finds its files here; or None."""
    return next((each for each in layouts() if each.name not in but and each.holds(path)), None)
