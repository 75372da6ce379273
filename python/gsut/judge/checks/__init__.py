"""Judges results by tables of checks."""

from gsut.judge.checks.check import (
    NOT_GOOD,
    SHAKY,
    UNUSABLE,
    Check,
    combine_verdicts,
    find_faults,
    judge,
)
from gsut.judge.checks.pictures import MANY, PICTURE_CHECKS, PictureQuality, judge_pictures
from gsut.judge.checks.poses import (
    FEW_AGREE,
    IMPOSSIBLE_TURN,
    PosesQuality,
    judge_poses,
)
from gsut.judge.checks.training import MOVING, judge_training
