"""Verdicts at the end of commands: how good a result is, why, and what to try next."""

from gsut.run.verdicts.pictures import judge_pictures
from gsut.run.verdicts.poses import (
    FEW_AGREE,
    FEW_AGREE_ROLLING,
    FOCAL_LIMITS,
    PosesQuality,
    count_exceeded,
    judge_poses,
)
from gsut.run.verdicts.training import judge_training
from gsut.run.verdicts.verdict import Fault, Verdict, combine_verdicts

__all__ = [
    "FEW_AGREE",
    "FEW_AGREE_ROLLING",
    "FOCAL_LIMITS",
    "Fault",
    "PosesQuality",
    "Verdict",
    "combine_verdicts",
    "count_exceeded",
    "judge_pictures",
    "judge_poses",
    "judge_training",
]
