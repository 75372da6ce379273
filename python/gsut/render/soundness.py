"""Checks Gaussians before a render, and that they are still the same before its backward pass."""

from __future__ import annotations

import warnings
import zlib
from typing import Any

import numpy as np

from gsut.gaussians import Gaussians

# Least and largest scale, and largest coordinate, in world units, up to which float32 follows the
# double reference: squares of products of these overflow, or vanish, beyond.
_LEAST_LENGTH = 1e-12
_LARGEST_LENGTH = 1e12


def sum_bits(gaussians: Any, features: np.ndarray | None = None) -> int:
    """Computes a number that changes if Gaussians are changed, moved or put into another order."""
    mark = zlib.crc32(gaussians.means.tobytes())
    others = [getattr(gaussians, name) for name in gaussians.list_arrays()[1:]]
    for array in others if features is None else [*others, features]:
        words = array.reshape(-1).view(np.uint32)
        mark = zlib.crc32(np.add.reduce(words, dtype=np.uint32).tobytes(), mark)
    return mark


def warn_of_undrawn(gaussians: Gaussians) -> None:
    """Warns, with their number, of Gaussians that float32 leaves out or draws wrongly.

    Python shows the warning once for each line of the caller's code.
    """
    g = gaussians
    if len(g) == 0:
        return
    with np.errstate(all="ignore"):
        low, high = np.log(_LEAST_LENGTH), np.log(_LARGEST_LENGTH)
        inside = g.log_scales.min() >= low and g.log_scales.max() <= high
        inside = inside and g.means.min() >= -_LARGEST_LENGTH and g.means.max() <= _LARGEST_LENGTH
        rest = (array.reshape(-1) for array in (g.quats, g.opacity_logits, g.sh))
        if inside and all(np.isfinite(np.dot(array, array)) for array in rest):
            return
        arrays = (g.means, g.quats, g.log_scales, g.opacity_logits, g.sh)
        finite = np.all([np.isfinite(a.reshape(len(g), -1)).all(axis=1) for a in arrays], axis=0)
        short, long = g.log_scales.min(axis=1) < low, g.log_scales.max(axis=1) > high
        far = np.abs(g.means).max(axis=1) > _LARGEST_LENGTH
    broken, beyond = np.count_nonzero(~finite), np.count_nonzero(finite & (short | long | far))
    reports = []
    if broken:
        reports.append(f"{broken:,} have a parameter that is not finite and are not drawn")
    if beyond:
        reports.append(
            f"{beyond:,} have a scale or coordinate outside {_LEAST_LENGTH:g} to "
            f"{_LARGEST_LENGTH:g}, where float32 may miss them; rescale the scene or give "
            'dtype="float64"'
        )
    if reports:
        message = f"of {len(g):,} Gaussians {'; '.join(reports)}"
        warnings.warn(message, RuntimeWarning, stacklevel=3)
