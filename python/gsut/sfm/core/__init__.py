"""Photographs, features, matches, and the solver that turns these into poses and points."""

from gsut.sfm.core.epipolar import (
    compute_readout_poses,
    find_readout_moments,
    measure_angular_errors,
    measure_pixels_per_radian,
)
from gsut.sfm.core.features import Features, OnProgress, collect_features, detect_features
from gsut.sfm.core.findings import Findings, RigFit, Zoom
from gsut.sfm.core.log import PosesLog
from gsut.sfm.core.look_alikes import find_look_alikes, separate_look_alikes
from gsut.sfm.core.mapping import Mapping, choose_shutter, require_global_shutter
from gsut.sfm.core.matching import PairMatches, RawMatches, find_frame_numbers, match_images
from gsut.sfm.core.models import find_further_models
from gsut.sfm.core.options import PosesOptions, add_lens_readout
from gsut.sfm.core.photographs import (
    FEWEST_IMAGES,
    TANGENT,
    Photographs,
    check_lens,
    find_photographs,
    list_photographs,
    require_central,
)
from gsut.sfm.core.selection import choose_connected_pairs, keep_most_distinct, select_pairs
from gsut.sfm.core.solution import (
    FEATURE_VARIANCE,
    Images,
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
from gsut.sfm.core.solver import (
    Adjustment,
    OnStep,
    ReadoutMotion,
    RigConstraint,
    adjust_poses,
    adjust_registered,
    list_extension_settings,
    select_verified_pairs,
    solve_poses,
)
from gsut.sfm.core.stages import FOLDER, Stages, digest_key
from gsut.sfm.core.threads import set_threads
from gsut.sfm.core.verification import (
    explain_failure,
    find_picture_faults,
    require_overlap,
    verify_matches,
)

__all__ = [
    "FEATURE_VARIANCE",
    "FEWEST_IMAGES",
    "FOLDER",
    "TANGENT",
    "Adjustment",
    "Features",
    "Findings",
    "Images",
    "Mapping",
    "OnProgress",
    "OnStep",
    "PairMatches",
    "Photographs",
    "PosesLog",
    "PosesOptions",
    "RawMatches",
    "ReadoutMotion",
    "RigConstraint",
    "RigFit",
    "Solution",
    "Stages",
    "Zoom",
    "add_lens_readout",
    "adjust_poses",
    "adjust_registered",
    "average_colors",
    "check_lens",
    "choose_connected_pairs",
    "choose_shutter",
    "collect_features",
    "compute_readout_poses",
    "detect_features",
    "digest_key",
    "evaluate_observations",
    "explain_failure",
    "find_frame_numbers",
    "find_further_models",
    "find_look_alikes",
    "find_photographs",
    "find_picture_faults",
    "find_readout_moments",
    "gather_pixels",
    "keep_most_distinct",
    "list_extension_settings",
    "list_photographs",
    "match_images",
    "measure_agreement",
    "measure_angular_errors",
    "measure_diagonal",
    "measure_pixels_per_radian",
    "measure_rotation_angles",
    "require_central",
    "require_global_shutter",
    "require_overlap",
    "select_pairs",
    "select_verified_pairs",
    "separate_look_alikes",
    "set_threads",
    "similarity_from_points",
    "solve_poses",
    "transform_to_cameras",
    "verify_matches",
]
