"""What a way to reduce Gaussians is, and how it is found by its name."""

from __future__ import annotations

import dataclasses
import importlib
from collections.abc import Callable
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.gaussians import Gaussians
from gsut.run.options import list_choices

METHODS = list_choices("compact/methods", "ghap")


@dataclasses.dataclass(frozen=True)
class Method:
    """One way to reduce Gaussians: `METHOD` of a file of compact/methods.

    Attributes:
        reduce: called with Gaussians, how many to keep, their scores, views, seed and `on_view`
            (see `compact`); returns the Gaussians.
        score: what is asked of the views, whatever number is kept: called with Gaussians, at least
            one view and `on_view`, which is called after each view; returns (N,) float64. None: the
            method does not look.
        needs_views: it cannot do without.
        only_chooses: what it keeps stays as it is, so that any primitive will do; others merge what
            must be Gaussians.
    """

    reduce: Callable[..., Gaussians]
    score: Callable[..., np.ndarray] | None = None
    needs_views: bool = False
    only_chooses: bool = False


def find_method(name: str) -> Method:
    """Finds the method of a name.

    Raises:
        InputError: there is none; lists the known ones.
    """
    if name not in METHODS:
        raise InputError(f'method "{name}" is unknown; known: {", ".join(METHODS)}')
    return importlib.import_module(f"gsut.compact.methods.{name.replace('-', '_')}").METHOD


def keep_best(gaussians: Gaussians, target: int, scores: np.ndarray, *_: Any) -> Gaussians:
    """Keeps the `target` Gaussians with the highest scores, in their order; the first of equals."""
    return gaussians[np.sort(np.argsort(-scores, kind="stable")[:target])]
