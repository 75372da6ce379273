"""Structure from motion: photographs and a lens in, camera poses and points out."""

from gsut.sfm.mapping import PosesLog
from gsut.sfm.photographs import FOLDER, PosesOptions, add_lens_readout, check_lens
from gsut.sfm.pipeline import PosesResult, find_poses, read_finished
from gsut.sfm.points import TriangulatedPoints, triangulate
from gsut.sfm.report import DatasetCalibration, calibrate_from_dataset, is_finished
from gsut.sfm.world import (
    PoseErrors,
    compare_datasets,
    compare_poses,
    fit_positions,
    read_positions,
)

__all__ = [
    "FOLDER",
    "DatasetCalibration",
    "PoseErrors",
    "PosesLog",
    "PosesOptions",
    "PosesResult",
    "TriangulatedPoints",
    "add_lens_readout",
    "calibrate_from_dataset",
    "check_lens",
    "compare_datasets",
    "compare_poses",
    "find_poses",
    "fit_positions",
    "is_finished",
    "read_finished",
    "read_positions",
    "triangulate",
]
