"""Lenses estimated from photographs: candidates, search, refinement and what remains in doubt."""

from gsut.sfm.lens.cameras import search_lenses
from gsut.sfm.lens.candidates import guess_lenses
from gsut.sfm.lens.center import free_center
from gsut.sfm.lens.covariance import estimate_lens_sigmas
from gsut.sfm.lens.differences import measure_lens_difference, measure_pose_differences
from gsut.sfm.lens.doubt import describe_cameras, judge_lens
from gsut.sfm.lens.information import (
    GROUPS,
    WeightedObservations,
    differentiate_by_turn,
    invert_scaled,
)
from gsut.sfm.lens.jackknife import adjust_without_groups, estimate_focal_sigma
from gsut.sfm.lens.prior import find_focal, hold_focal
from gsut.sfm.lens.ranking import ROUGH
from gsut.sfm.lens.sightings import index_points, join_points
from gsut.sfm.lens.still_camera import require_motion
