"""How far Gaussians are from what was written."""

from __future__ import annotations

import numpy as np

from gsut.formats._quantize import normalize_quats, opacity_from_logits
from gsut.gaussians import Gaussians

_ROWS = 1 << 14  # that are compared at a time


def measure_errors(before: Gaussians, after: Gaussians) -> dict[str, float]:
    """Measures the largest differences between Gaussians, row by row.

    Args:
        before, after: N Gaussians each; harmonics that one of them lacks count as 0.

    Returns:
        position: of a coordinate, in the scene's units; log_scale: of a natural logarithm;
        rotation_degrees; opacity: between 0 and 1; color: of the constant harmonic; harmonics: of
        the others.
    """
    parts = [
        _measure_part(before[first : first + _ROWS], after[first : first + _ROWS])
        for first in range(0, max(1, len(before)), _ROWS)
    ]
    return {name: max(part[name] for part in parts) for name in parts[0]}


def _measure_part(before: Gaussians, after: Gaussians) -> dict[str, float]:
    most = max(before.sh.shape[1], after.sh.shape[1])
    sh = [np.zeros((len(g), most, 3)) for g in (before, after)]
    for padded, g in zip(sh, (before, after), strict=True):
        padded[:, : g.sh.shape[1]] = g.sh
    a, b = normalize_quats(before.quats), normalize_quats(after.quats)
    # Half the angle by its sine, which is exact for small ones.
    half = np.minimum(np.linalg.norm(a - b, axis=1), np.linalg.norm(a + b, axis=1)) / 2
    return {
        "position": _find_largest(before.means, after.means),
        "log_scale": _find_largest(before.log_scales, after.log_scales),
        "rotation_degrees": float(np.degrees(4 * np.arcsin(np.max(half, initial=0.0)))),
        "opacity": _find_largest(
            opacity_from_logits(before.opacity_logits), opacity_from_logits(after.opacity_logits)
        ),
        "color": _find_largest(sh[0][:, 0], sh[1][:, 0]),
        "harmonics": _find_largest(sh[0][:, 1:], sh[1][:, 1:]),
    }


def _find_largest(before: np.ndarray, after: np.ndarray) -> float:
    return float(np.max(np.abs(before.astype(np.float64) - after), initial=0.0))
