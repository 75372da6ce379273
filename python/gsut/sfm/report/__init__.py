"""What a run writes: the dataset, poses.json, the verdict and the pages."""

from gsut.sfm.report.calibration import DatasetCalibration, calibrate_from_dataset
from gsut.sfm.report.notes import solution_notes
from gsut.sfm.report.output import (
    FIGURES,
    figures,
    is_finished,
    read_figures,
    write_dataset,
    write_models,
)
from gsut.sfm.report.page import write_report
from gsut.sfm.report.verdict import poses_verdict

__all__ = [
    "FIGURES",
    "DatasetCalibration",
    "calibrate_from_dataset",
    "figures",
    "is_finished",
    "poses_verdict",
    "read_figures",
    "solution_notes",
    "write_dataset",
    "write_models",
    "write_report",
]
