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
from gsut.data.check_images import check_bits
from gsut.data.color_points import UNCOLORED, color_points, has_colors, points_seen
from gsut.data.convert import convert_dataset, save_dataset, writable_layouts
from gsut.data.depth_files import MILLIMETRE, read_depth
from gsut.data.digests import scene_digests
from gsut.data.doctor import diagnose, diagnose_scene, findings_text
from gsut.data.findings import SEVERITIES, DatasetError, Finding, some_names, sorted_findings
from gsut.data.images import (
    IMAGE_SUFFIXES,
    decode_image,
    decode_mask,
    read_header,
    shrink_image,
    shrink_mask,
)
from gsut.data.layouts import layouts
from gsut.data.layouts.description import KEYS as PARTS
from gsut.data.layouts.folder import find_images, find_lens_file
from gsut.data.load import load_dataset, read_dataset
from gsut.data.masks import find_mask
from gsut.data.memory import make_scene
from gsut.data.normal_files import read_normals
from gsut.data.points import TRIANGULATED, load_points_ply, points_ply, usable_points
from gsut.data.poses import OPENGL_FROM_OPENCV, centers_of, inverse, rigid_transform
from gsut.data.rig import Rig, read_rig, relative_changes, write_rig
from gsut.data.scene import Scene, View, keep_at_most
from gsut.data.shutter import frame_times, neighbours_in_time, views_within, with_shutter
from gsut.data.split import TEST_EVERY
from gsut.data.training_views import Level, TrainingViews
from gsut.data.write_colmap import ColmapImage, ColmapModel, colmap_texts
from gsut.data.write_nerfstudio import write_transforms

__all__ = [
    "CAPTURE",
    "CAPTURE_FOLDER",
    "IMAGE_SUFFIXES",
    "MILLIMETRE",
    "OPENGL_FROM_OPENCV",
    "PARTS",
    "SEVERITIES",
    "STRIP",
    "TEST_EVERY",
    "TRIANGULATED",
    "UNCOLORED",
    "ColmapImage",
    "ColmapModel",
    "DatasetError",
    "Finding",
    "Frame",
    "Level",
    "Rig",
    "Scene",
    "TrainingViews",
    "View",
    "capture_state",
    "centers_of",
    "check_bits",
    "check_colors",
    "check_lenses",
    "check_points",
    "check_poses",
    "colmap_texts",
    "color_points",
    "convert_dataset",
    "decode_image",
    "decode_mask",
    "diagnose",
    "diagnose_scene",
    "find_images",
    "find_lens_file",
    "find_mask",
    "findings_text",
    "frame_times",
    "has_colors",
    "inverse",
    "keep_at_most",
    "layouts",
    "lens_of_path",
    "load_dataset",
    "load_points_ply",
    "make_scene",
    "neighbours_in_time",
    "points_ply",
    "points_seen",
    "read_capture",
    "read_dataset",
    "read_depth",
    "read_header",
    "read_normals",
    "read_path",
    "read_rig",
    "relative_changes",
    "rigid_transform",
    "save_dataset",
    "scene_digests",
    "shrink_image",
    "shrink_mask",
    "some_names",
    "sorted_findings",
    "usable_points",
    "view_agreement",
    "views_within",
    "with_shutter",
    "writable_layouts",
    "write_rig",
    "write_transforms",
]
