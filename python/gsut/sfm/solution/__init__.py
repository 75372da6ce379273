"""Poses and points: the solver that makes them of matches, and what its result shows."""

from gsut.sfm.solution.adjustment import (
    CENTER,
    LOSS_SCALE,
    Adjustment,
    LensFlag,
    LensFlags,
    ReadoutMotion,
    RigConstraint,
    StatedPlaces,
    StatedPoints,
    StatedTurns,
    find_lens_prior,
    index_lenses,
)
from gsut.sfm.solution.evidence import (
    compare_solutions,
    measure_contradiction,
    measure_match_errors,
)
from gsut.sfm.solution.look_alikes import LookAlikes, separate_look_alikes
from gsut.sfm.solution.models import find_further_models, solve_left_out
from gsut.sfm.solution.result import (
    FEATURE_VARIANCE,
    Solution,
    measure_agreement,
    measure_diagonal,
    measure_line_times,
    similarity_from_points,
    transform_to_cameras,
)
from gsut.sfm.solution.solver import (
    OnStep,
    adjust_poses,
    adjust_registered,
    solve_poses,
)
