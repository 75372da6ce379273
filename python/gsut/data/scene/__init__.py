"""A dataset in memory: `Scene` and its views, their split, shutter, depths and normals."""

from gsut.data.scene.maps import MILLIMETRE, read_depth, read_normals
from gsut.data.scene.scene import Scene, View
from gsut.data.scene.shutter import frame_times, neighbours_in_time, views_within, with_shutter
from gsut.data.scene.split import TEST_EVERY, split_views

__all__ = [
    "MILLIMETRE",
    "TEST_EVERY",
    "Scene",
    "View",
    "frame_times",
    "neighbours_in_time",
    "read_depth",
    "read_normals",
    "split_views",
    "views_within",
    "with_shutter",
]
