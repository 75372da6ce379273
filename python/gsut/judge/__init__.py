"""Decides by evidence: which of two structures matches prefer, and how good a result is."""

from gsut.judge.checks import combine_verdicts, find_faults
from gsut.judge.epipolar import (
    compute_readout_poses,
    find_readout_moments,
    measure_angular_errors,
    measure_pixels_per_radian,
)
from gsut.judge.pictures import PICTURE_CHECKS, PictureQuality, judge_pictures
from gsut.judge.poses import (
    FEW_AGREE,
    FOCAL_LIMIT,
    PosesQuality,
    has_bent,
    judge_poses,
)
from gsut.judge.preference import (
    Matches,
    Preference,
    Structure,
    estimate_noise,
    prefer,
    score_errors,
)
from gsut.judge.training import judge_training

__all__ = [
    "FEW_AGREE",
    "FOCAL_LIMIT",
    "PICTURE_CHECKS",
    "Matches",
    "PictureQuality",
    "PosesQuality",
    "Preference",
    "Structure",
    "combine_verdicts",
    "compute_readout_poses",
    "estimate_noise",
    "find_faults",
    "find_readout_moments",
    "has_bent",
    "judge_pictures",
    "judge_poses",
    "judge_training",
    "measure_angular_errors",
    "measure_pixels_per_radian",
    "prefer",
    "score_errors",
]
