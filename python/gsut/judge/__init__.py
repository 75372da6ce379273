"""Decides by evidence: which of two structures explains the same matches better."""

from gsut.judge.epipolar import (
    compute_readout_poses,
    find_readout_moments,
    measure_angular_errors,
    measure_pixels_per_radian,
)
from gsut.judge.preference import (
    SURE,
    Matches,
    Preference,
    Structure,
    estimate_noise,
    prefer,
    score_errors,
)

__all__ = [
    "SURE",
    "Matches",
    "Preference",
    "Structure",
    "compute_readout_poses",
    "estimate_noise",
    "find_readout_moments",
    "measure_angular_errors",
    "measure_pixels_per_radian",
    "prefer",
    "score_errors",
]
