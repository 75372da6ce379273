"""Lens files in and out, a module a program; those with a "_" hold what several need."""

from gsut.lens.files._camera_info import camera_from_info, info_from_camera
from gsut.lens.files._load import list_suffixes, load_camera, save_camera
from gsut.lens.files._values import FROM_ZERO
from gsut.lens.files.colmap import camera_from_colmap, list_text_cameras, to_colmap
from gsut.lens.files.colmap_binary import list_binary_cameras
from gsut.lens.files.kalibr import is_camchain
from gsut.lens.files.nerfstudio import (
    LENS_FILE,
    camera_from_nerfstudio,
    format_nerfstudio,
    merge_frame_lens,
)
from gsut.lens.files.own import OWN_SUFFIX, camera_from_values, values_from_camera
