"""A dataset in memory: `Scene` and its views, their split, shutter, depths and normals."""

from gsut.data.scene.maps import MILLIMETRE, read_depth, read_normals
from gsut.data.scene.scene import Scene, View
from gsut.data.scene.shutter import find_time_neighbours, order_frames, split_exposure, with_shutter
from gsut.data.scene.split import TEST_EVERY, choose_inner_views, hold_out_views, split_views

__all__ = [
    "MILLIMETRE",
    "TEST_EVERY",
    "Scene",
    "View",
    "choose_inner_views",
    "find_time_neighbours",
    "hold_out_views",
    "order_frames",
    "read_depth",
    "read_normals",
    "split_exposure",
    "split_views",
    "with_shutter",
]
