"""Judges results: tables of checks, and the verdicts that they give."""

from gsut.judge.checks import Check, Fault, combine_verdicts, find_faults
from gsut.judge.pictures import PICTURE_CHECKS, PictureQuality, judge_pictures
from gsut.judge.poses import (
    FEW_AGREE,
    FOCAL_LIMIT,
    POSES_CHECKS,
    PosesQuality,
    has_bent,
    judge_poses,
)
from gsut.judge.training import TRAINING_CHECKS, judge_training

__all__ = [
    "FEW_AGREE",
    "FOCAL_LIMIT",
    "PICTURE_CHECKS",
    "POSES_CHECKS",
    "TRAINING_CHECKS",
    "Check",
    "Fault",
    "PictureQuality",
    "PosesQuality",
    "combine_verdicts",
    "find_faults",
    "has_bent",
    "judge_pictures",
    "judge_poses",
    "judge_training",
]
