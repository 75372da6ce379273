"""Verdicts at the end of commands: how good a result is, why, and what to try next."""

from gsut.run.verdicts.pictures import judge_pictures
from gsut.run.verdicts.poses import (
    FEW_AGREE,
    FOCAL_LIMITS,
    PosesQuality,
    count_exceeded,
    has_bent,
    judge_poses,
)
from gsut.run.verdicts.training import judge_training
from gsut.run.verdicts.verdict import Fault, Verdict, combine_verdicts

__all__ = [
    "FEW_AGREE",
    "FOCAL_LIMITS",
    "Fault",
    "PosesQuality",
    "Verdict",
    "combine_verdicts",
    "count_exceeded",
    "has_bent",
    "judge_pictures",
    "judge_poses",
    "judge_training",
]
