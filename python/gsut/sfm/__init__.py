"""Structure from motion: photographs and a lens in, camera poses and points out."""

from gsut.sfm.align import PoseErrors, centers_of, compare_poses
from gsut.sfm.bearing_points import BearingPoints
from gsut.sfm.calibrate_dataset_page import write_page
from gsut.sfm.estimate import PosesResult, estimate_poses, is_finished
from gsut.sfm.features import Features, features_in, find_all_features, no_features
from gsut.sfm.inputs import Photographs, find_photographs
from gsut.sfm.matching import PairMatches, match_and_verify, preview_pairs
from gsut.sfm.options import PosesOptions
from gsut.sfm.output import TRANSFORMS, check_lenses, figures, write_dataset
from gsut.sfm.pairs import choose_pairs
from gsut.sfm.refine_lens import RefinedLens, refine_lens
from gsut.sfm.report import REPORT, write_report
from gsut.sfm.rig_file import Rig, read_rig, relative_changes, write_rig
from gsut.sfm.solution import Solution, at_sights, diagonal, in_cameras, refine, solve
from gsut.sfm.stages import FOLDER, write_atomically

__all__ = [
    "FOLDER",
    "REPORT",
    "TRANSFORMS",
    "BearingPoints",
    "Features",
    "PairMatches",
    "Photographs",
    "PoseErrors",
    "PosesOptions",
    "PosesResult",
    "RefinedLens",
    "Rig",
    "Solution",
    "at_sights",
    "centers_of",
    "check_lenses",
    "choose_pairs",
    "compare_poses",
    "diagonal",
    "estimate_poses",
    "features_in",
    "figures",
    "find_all_features",
    "find_photographs",
    "in_cameras",
    "is_finished",
    "match_and_verify",
    "no_features",
    "preview_pairs",
    "read_rig",
    "refine",
    "refine_lens",
    "relative_changes",
    "solve",
    "write_atomically",
    "write_dataset",
    "write_page",
    "write_report",
    "write_rig",
]
