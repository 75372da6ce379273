"""A dataset in memory: `Scene` and its views, their split, shutter and depths."""

from gsut.data.scene.depth_form import DISTANCES, MILLIMETRE, DepthForm
from gsut.data.scene.digests import capture_state, describe_changes, digest_scene
from gsut.data.scene.lines import (
    find_line_times,
    find_visible_points,
    interpolate_poses,
    project_points,
)
from gsut.data.scene.maps import HALF_PIXEL, find_bad_depths, has_depths, read_depth
from gsut.data.scene.scene import Scene, View, keep_at_most
from gsut.data.scene.shutter import order_frames, split_last_number, with_shutter
from gsut.data.scene.split import TEST_EVERY, choose_inner_views, hold_out_views, split_views
from gsut.data.scene.training_views import SMALLEST_SIDE, Level, TrainingViews
from gsut.data.scene.upright import count_lens_turns, find_up, find_upright_poses
