"""What a run writes: the dataset, poses.json, the verdict and the pages."""

from gsut.sfm.report.output import is_finished, read_figures, read_scale_sigma, write_poses
from gsut.sfm.report.verdict import rate_poses
