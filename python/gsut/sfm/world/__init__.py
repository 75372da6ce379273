"""Poses compared with a reference, and placed in the world of positions or of the earth."""

from gsut.sfm.world.comparison import (
    PoseErrors,
    compare_datasets,
    compare_poses,
    read_poses_by_path,
)
from gsut.sfm.world.control import place_by_control
from gsut.sfm.world.control_file import find_control
from gsut.sfm.world.earth import find_stated_up, place_on_earth
from gsut.sfm.world.markers import add_markers, place_by_markers
from gsut.sfm.world.positions import fit_positions, read_positions
