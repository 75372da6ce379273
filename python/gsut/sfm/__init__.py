"""Structure from motion: photographs and a lens in, camera poses and points out."""

from gsut.sfm.mapping import PosesLog
from gsut.sfm.photographs import PosesOptions, check_lens
from gsut.sfm.pipeline import (
    PosesResult,
    find_poses,
    read_finished,
    run_mapping,
    start_mapping,
)
from gsut.sfm.report import is_finished, read_scale_sigma
from gsut.sfm.world import (
    PoseErrors,
    compare_datasets,
    compare_poses,
    fit_positions,
    read_positions,
)
