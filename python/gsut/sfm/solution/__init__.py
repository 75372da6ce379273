"""Poses and points: the solver that makes them of matches, and what its result shows."""

from gsut.sfm.solution.look_alikes import LookAlikes, find_look_alikes, separate_look_alikes
from gsut.sfm.solution.models import find_further_models, solve_left_out
from gsut.sfm.solution.result import (
    FEATURE_VARIANCE,
    Solution,
    average_colors,
    evaluate_observations,
    gather_pixels,
    measure_agreement,
    measure_diagonal,
    measure_rotation_angles,
    similarity_from_points,
    transform_to_cameras,
)
from gsut.sfm.solution.solver import (
    Adjustment,
    LensFlags,
    OnStep,
    ReadoutMotion,
    RigConstraint,
    StatedPlaces,
    adjust_poses,
    adjust_registered,
    index_lenses,
    list_extension_settings,
    solve_poses,
)

__all__ = [
    "FEATURE_VARIANCE",
    "Adjustment",
    "LensFlags",
    "LookAlikes",
    "OnStep",
    "ReadoutMotion",
    "RigConstraint",
    "Solution",
    "StatedPlaces",
    "adjust_poses",
    "adjust_registered",
    "average_colors",
    "evaluate_observations",
    "find_further_models",
    "find_look_alikes",
    "gather_pixels",
    "index_lenses",
    "list_extension_settings",
    "measure_agreement",
    "measure_diagonal",
    "measure_rotation_angles",
    "separate_look_alikes",
    "similarity_from_points",
    "solve_left_out",
    "solve_poses",
    "transform_to_cameras",
]
