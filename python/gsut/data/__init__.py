"""Datasets: scene and views, readers and writers (one module a format), splits, checks."""

from gsut.data.assemble import Frame
from gsut.data.camera_path import lens_of_path, read_path
from gsut.data.capture_file import (
    CAPTURE,
    CAPTURE_FOLDER,
    STRIP,
    capture_state,
    read_capture,
)
from gsut.data.check_colors import check_colors, view_agreement
from gsut.data.check_geometry import check_lenses, check_points, check_poses
from gsut.data.colmap import find_mask
from gsut.data.color_points import UNCOLORED, color_points, has_colors
from gsut.data.digests import scene_digests
from gsut.data.doctor import diagnose, findings_text
from gsut.data.findings import SEVERITIES, DatasetError, Finding, some_names, sorted_findings
from gsut.data.folder import find_images, find_lens_file
from gsut.data.images import (
    IMAGE_SUFFIXES,
    decode_image,
    decode_mask,
    read_header,
    shrink_image,
    shrink_mask,
)
from gsut.data.load import load_dataset, read_dataset
from gsut.data.points import TRIANGULATED, load_points_ply
from gsut.data.poses import OPENGL_FROM_OPENCV, inverse, rigid_transform
from gsut.data.scene import Scene, View
from gsut.data.shutter import frame_times, with_shutter
from gsut.data.split import TEST_EVERY
from gsut.data.training_views import Level, TrainingViews
from gsut.data.write_nerfstudio import points_ply, write_transforms

__all__ = [
    "CAPTURE",
    "CAPTURE_FOLDER",
    "IMAGE_SUFFIXES",
    "OPENGL_FROM_OPENCV",
    "SEVERITIES",
    "STRIP",
    "TEST_EVERY",
    "TRIANGULATED",
    "UNCOLORED",
    "DatasetError",
    "Finding",
    "Frame",
    "Level",
    "Scene",
    "TrainingViews",
    "View",
    "capture_state",
    "check_colors",
    "check_lenses",
    "check_points",
    "check_poses",
    "color_points",
    "decode_image",
    "decode_mask",
    "diagnose",
    "find_images",
    "find_lens_file",
    "find_mask",
    "findings_text",
    "frame_times",
    "has_colors",
    "inverse",
    "lens_of_path",
    "load_dataset",
    "load_points_ply",
    "points_ply",
    "read_capture",
    "read_dataset",
    "read_header",
    "read_path",
    "rigid_transform",
    "scene_digests",
    "shrink_image",
    "shrink_mask",
    "some_names",
    "sorted_findings",
    "view_agreement",
    "with_shutter",
    "write_transforms",
]
