"""Photographs, features, matches, and the solver that turns these into poses and points."""

from gsut.sfm.core.alignment import rotation_angles, similarity
from gsut.sfm.core.correspondences import OnProgress, collect_features, match_images
from gsut.sfm.core.epipolar import angular_errors, pixels_per_radian, readout_moments, readout_poses
from gsut.sfm.core.features import Features, features_in
from gsut.sfm.core.log import PosesLog
from gsut.sfm.core.look_alikes import LookAlikes, ToldApart, find_look_alikes, tell_apart
from gsut.sfm.core.matching import PairMatches, RawMatches
from gsut.sfm.core.models import further_models, refine_registered
from gsut.sfm.core.moving import Moving
from gsut.sfm.core.options import PosesOptions, add_lens_readout
from gsut.sfm.core.overlap import count_exceeded, picture_faults, require_overlap, why_nothing
from gsut.sfm.core.pairs import times_of
from gsut.sfm.core.photographs import (
    FEWEST_IMAGES,
    TANGENT,
    Photographs,
    check_lens,
    find_photographs,
    photographs_in,
    require_central,
)
from gsut.sfm.core.selection import choose_connected_pairs, keep_most_distinct, only_pairs
from gsut.sfm.core.solution import (
    FEATURE_VARIANCE,
    OnRig,
    Solution,
    diagonal,
    evaluate_observations,
    in_cameras,
    matches_in_points,
    mean_colors,
    refine,
    solve,
)
from gsut.sfm.core.stages import FOLDER, Stages, digest
from gsut.sfm.core.threads import set_threads
from gsut.sfm.core.verification import verify

__all__ = [
    "FEATURE_VARIANCE",
    "FEWEST_IMAGES",
    "FOLDER",
    "TANGENT",
    "Features",
    "LookAlikes",
    "Moving",
    "OnProgress",
    "OnRig",
    "PairMatches",
    "Photographs",
    "PosesLog",
    "PosesOptions",
    "RawMatches",
    "Solution",
    "Stages",
    "ToldApart",
    "add_lens_readout",
    "angular_errors",
    "check_lens",
    "choose_connected_pairs",
    "collect_features",
    "count_exceeded",
    "diagonal",
    "digest",
    "evaluate_observations",
    "features_in",
    "find_look_alikes",
    "find_photographs",
    "further_models",
    "in_cameras",
    "keep_most_distinct",
    "match_images",
    "matches_in_points",
    "mean_colors",
    "only_pairs",
    "photographs_in",
    "picture_faults",
    "pixels_per_radian",
    "readout_moments",
    "readout_poses",
    "refine",
    "refine_registered",
    "require_central",
    "require_overlap",
    "rotation_angles",
    "set_threads",
    "similarity",
    "solve",
    "tell_apart",
    "times_of",
    "verify",
    "why_nothing",
]
