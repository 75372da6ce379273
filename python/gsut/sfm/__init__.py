"""Structure from motion: photographs and a lens in, camera poses and points out."""

from gsut.sfm.align import PoseErrors, centers_of, compare_poses, errors_against, poses_by_path
from gsut.sfm.bearing_points import BearingPoints
from gsut.sfm.dataset_calibration import calibrate_from_dataset
from gsut.sfm.estimate import PosesResult, estimate_poses, is_finished
from gsut.sfm.features import Features, features_in, find_all_features, no_features
from gsut.sfm.inputs import Photographs, find_photographs
from gsut.sfm.lens_refinement import refine_lens
from gsut.sfm.matching import PairMatches, match_and_verify, preview_pairs
from gsut.sfm.options import PosesOptions
from gsut.sfm.pairs import choose_pairs
from gsut.sfm.rig_file import Rig, read_rig, relative_changes, write_rig
from gsut.sfm.solution import Solution, at_sights, diagonal, in_cameras, refine, solve
from gsut.sfm.stages import FOLDER

__all__ = [
    "FOLDER",
    "BearingPoints",
    "Features",
    "PairMatches",
    "Photographs",
    "PoseErrors",
    "PosesOptions",
    "PosesResult",
    "Rig",
    "Solution",
    "at_sights",
    "calibrate_from_dataset",
    "centers_of",
    "choose_pairs",
    "compare_poses",
    "diagonal",
    "errors_against",
    "estimate_poses",
    "features_in",
    "find_all_features",
    "find_photographs",
    "in_cameras",
    "is_finished",
    "match_and_verify",
    "no_features",
    "poses_by_path",
    "preview_pairs",
    "read_rig",
    "refine",
    "refine_lens",
    "relative_changes",
    "solve",
    "write_rig",
]
