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
# Longest needle, in widths, that float32 follows within the stated error: a ray's distance from it
# has the rounding error of its length.
_LONGEST_NEEDLE = 1e5
# Least and largest norm of a quaternion, whose reciprocal float32 must hold.
_LEAST_NORM = 1e-35
_LARGEST_NORM = 3e37
# Words that `sum_bits` adds up at once: odd, so that it notices when all signs turn.
_WORDS_OF_A_SUM = 1023


def sum_bits(gaussians: Any, features: np.ndarray | None = None) -> int:
    """Computes a number that changes if Gaussians are changed, moved or put into another order."""
    mark = zlib.crc32(gaussians.origin.tobytes())
    arrays = [getattr(gaussians, name) for name in gaussians.list_arrays()]
    for array in arrays if features is None else [*arrays, features]:
        mark = zlib.crc32(_sum_both_ways(array.reshape(-1).view(np.uint32)).tobytes(), mark)
    return mark


def _sum_both_ways(words: np.ndarray) -> np.ndarray:
    """Sums the words of each group of consecutive ones, and those at equal places of the groups.

    Two words that exchange their places change one of these. A checksum of all words would take
    three times as long.
    """
    whole = len(words) // _WORDS_OF_A_SUM * _WORDS_OF_A_SUM
    groups = words[:whole].reshape(-1, _WORDS_OF_A_SUM)
    sums = [np.add.reduce(groups, axis=axis, dtype=np.uint32) for axis in (0, 1)]
    return np.concatenate([*sums, words[whole:]])


def _measure_needles(log_scales: np.ndarray) -> np.ndarray:
    """Measures (N,) the logarithm of the longest axis over the middle one.

    Column by column: it runs before each render, and sorting rows takes ten times as long.
    """
    a, b, c = log_scales.T
    low, high = np.minimum(a, b), np.maximum(a, b)
    return np.maximum(high, c) - np.maximum(low, np.minimum(high, c))


def warn_of_undrawn(gaussians: Gaussians) -> None:
    """Warns, with their number, of Gaussians that float32 leaves out or draws less exactly.

    Python shows the warning once for each line of the caller's code.
    """
    g = gaussians
    if len(g) == 0:
        return
    with np.errstate(all="ignore"):
        low, high = np.log(_LEAST_LENGTH), np.log(_LARGEST_LENGTH)
        squares = np.einsum("ij,ij->i", g.quats, g.quats)
        inside = low <= g.log_scales.min() <= g.log_scales.max() <= high
        inside = inside and _measure_needles(g.log_scales).max() <= np.log(_LONGEST_NEEDLE)
        inside = inside and g.means.min() >= -_LARGEST_LENGTH and g.means.max() <= _LARGEST_LENGTH
        inside = inside and 0.0 < squares.min() <= squares.max() < np.inf
        rest = (array.reshape(-1) for array in (g.opacity_logits, g.sh))
        if inside and all(np.isfinite(np.dot(array, array)) for array in rest):
            return
        arrays = (g.means, g.quats, g.log_scales, g.opacity_logits, g.sh)
        finite = np.all([np.isfinite(a.reshape(len(g), -1)).all(axis=1) for a in arrays], axis=0)
        beyond = (g.log_scales.min(axis=1) < low) | (g.log_scales.max(axis=1) > high)
        beyond |= np.abs(g.means).max(axis=1) > _LARGEST_LENGTH
        norms = np.linalg.norm(g.quats.astype(np.float64), axis=1)
        turned = (norms > 0) & ((norms < _LEAST_NORM) | (norms > _LARGEST_NORM))
        thin = _measure_needles(g.log_scales) > np.log(_LONGEST_NEEDLE)
    causes = {
        "have a parameter that is not finite and are not drawn": ~finite,
        f"have a scale or coordinate outside {_LEAST_LENGTH:g} to {_LARGEST_LENGTH:g}, where "
        'float32 may miss them; rescale the scene or give dtype="float64"': finite & beyond,
        f"have a quaternion of a norm outside {_LEAST_NORM:g} to {_LARGEST_NORM:g}, where float32 "
        "may turn them wrongly; normalise it": finite & turned,
        f"are more than {_LONGEST_NEEDLE:g} times as long as wide, where float32 places them less "
        'exactly; shorten them or give dtype="float64"': finite & thin,
    }
    counts = {cause: np.count_nonzero(rows) for cause, rows in causes.items()}
    reports = [f"{count:,} {cause}" for cause, count in counts.items() if count]
    if reports:
        message = f"of {len(g):,} Gaussians {'; '.join(reports)}"
        warnings.warn(message, RuntimeWarning, stacklevel=3)
