"""Arrays of an optimizer: rows that grow, and masks as the core reads them."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from gsut.gaussians import Gaussians


def copy_rows(arrays: Gaussians, size: int, capacity: int) -> Gaussians:
    """Copies the first `size` rows into new float32 arrays of `capacity` rows; the others are 0."""
    rows: dict[str, Any] = {}
    for name in arrays.list_arrays():
        old = getattr(arrays, name)
        rows[name] = new = np.zeros((capacity, *old.shape[1:]), np.float32)
        new[:size] = old[:size]
    return Gaussians(**{**arrays.rule, **rows})


def read_rows(like: Gaussians, state: dict[str, Any]) -> Gaussians:
    """Returns Gaussians with the arrays of a state, drawn as `like`."""
    return dataclasses.replace(like, **state)


def to_mask_bytes(visible: np.ndarray | None) -> np.ndarray | None:
    if visible is None:
        return None
    visible = np.ascontiguousarray(visible)
    return visible.view(np.uint8) if visible.dtype.itemsize == 1 else (visible != 0).view(np.uint8)
