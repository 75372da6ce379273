"""More about poses: refine, localize, align, depth; `find_poses` is in gsut."""

from gsut.capture import Capture
from gsut.data.points import color_points
from gsut.data.rigs import read_rig
from gsut.refine import Localized, RefinedPose, localize_image, refine_pose
from gsut.refine.captures import CaptureAlignment, align_captures, align_to_cloud, find_changes
from gsut.sfm import PoseErrors, compare_poses
from gsut.surface.stereo import find_depth_maps

__all__ = [
    "Capture",
    "CaptureAlignment",
    "Localized",
    "PoseErrors",
    "RefinedPose",
    "align_captures",
    "align_to_cloud",
    "color_points",
    "compare_poses",
    "find_changes",
    "find_depth_maps",
    "localize_image",
    "read_rig",
    "refine_pose",
]
