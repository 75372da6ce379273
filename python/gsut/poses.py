"""More about poses: refine, localize, depth; `find_poses` is in gsut."""

from gsut.capture import Capture
from gsut.data.points import color_points
from gsut.data.rigs import read_rig
from gsut.refine import Localized, RefinedPose, localize_image, refine_pose
from gsut.sfm import PoseErrors, compare_poses
from gsut.surface.stereo import find_depth_maps

__all__ = [
    "Capture",
    "Localized",
    "PoseErrors",
    "RefinedPose",
    "color_points",
    "compare_poses",
    "find_depth_maps",
    "localize_image",
    "read_rig",
    "refine_pose",
]
