"""Any lens: `Camera`, fits and conversion, lens files, uncertainty."""

from gsut.lens.calibration_weights import CalibrationWeights
from gsut.lens.camera import Camera, camera_models
from gsut.lens.convert import run_convert
from gsut.lens.files import colmap_camera, load_camera, nerfstudio_camera
from gsut.lens.files.colmap import PARAMETER_COUNTS, format_colmap
from gsut.lens.files.kalibr import is_camchain
from gsut.lens.files.nerfstudio import format_nerfstudio
from gsut.lens.uncertainty import grid_pixels, save_uncertainty

__all__ = [
    "PARAMETER_COUNTS",
    "CalibrationWeights",
    "Camera",
    "camera_models",
    "colmap_camera",
    "format_colmap",
    "format_nerfstudio",
    "grid_pixels",
    "is_camchain",
    "load_camera",
    "nerfstudio_camera",
    "run_convert",
    "save_uncertainty",
]
