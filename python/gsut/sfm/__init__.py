"""Structure from motion: photographs and a lens in, camera poses and points out."""

from gsut.sfm.align import PoseErrors, compare_poses, errors_against, poses_by_path
from gsut.sfm.bearing_points import BearingPoints
from gsut.sfm.correspondences import collect_features, match_images
from gsut.sfm.dataset_calibration import DatasetCalibration, calibrate_from_dataset
from gsut.sfm.epipolar import (
    angular_errors,
    pixels_per_radian,
    readout_moments,
    readout_poses,
)
from gsut.sfm.estimate import (
    PosesResult,
    done_already,
    find_poses,
    is_finished,
    read_figures,
)
from gsut.sfm.features import Features, features_in
from gsut.sfm.inputs import Photographs, check_lens, find_photographs, require_central
from gsut.sfm.lens_refinement import refine_lens
from gsut.sfm.matching import PairMatches, verify
from gsut.sfm.options import PosesOptions, add_lens_readout
from gsut.sfm.positions import PositionFit, fit_positions, read_positions
from gsut.sfm.solution import Solution, diagonal, evaluate_observations, in_cameras, refine, solve
from gsut.sfm.stages import FOLDER
from gsut.sfm.triangulation import TriangulatedPoints, triangulate

__all__ = [
    "FOLDER",
    "BearingPoints",
    "DatasetCalibration",
    "Features",
    "PairMatches",
    "Photographs",
    "PoseErrors",
    "PosesOptions",
    "PosesResult",
    "PositionFit",
    "Solution",
    "TriangulatedPoints",
    "add_lens_readout",
    "angular_errors",
    "calibrate_from_dataset",
    "check_lens",
    "collect_features",
    "compare_poses",
    "diagonal",
    "done_already",
    "errors_against",
    "evaluate_observations",
    "features_in",
    "find_photographs",
    "find_poses",
    "fit_positions",
    "in_cameras",
    "is_finished",
    "match_images",
    "pixels_per_radian",
    "poses_by_path",
    "read_figures",
    "read_positions",
    "readout_moments",
    "readout_poses",
    "refine",
    "refine_lens",
    "require_central",
    "solve",
    "triangulate",
    "verify",
]
