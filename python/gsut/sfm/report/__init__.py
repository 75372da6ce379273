"""What a run writes: the dataset, poses.json, the verdict and the pages."""

from gsut.sfm.report.calibration import DatasetCalibration, calibrate_from_dataset
from gsut.sfm.report.output import is_finished, read_figures, write_poses

__all__ = [
    "DatasetCalibration",
    "calibrate_from_dataset",
    "is_finished",
    "read_figures",
    "write_poses",
]
