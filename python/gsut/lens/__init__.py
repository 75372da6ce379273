"""Any lens: `Camera`, fits and conversion, lens files, uncertainty."""

from gsut.lens.calibration_weights import CalibrationWeights
from gsut.lens.camera import Camera, camera_models
from gsut.lens.convert import Conversion, convert_camera, format_conversion
from gsut.lens.database import (
    LensProfile,
    find_lenses,
    is_lens_name,
    lens_by_name,
    load_lens,
)
from gsut.lens.field import (
    field_of_view,
    focal_params,
    has_focal_length,
    with_field_of_view,
    with_scaled_focal,
)
from gsut.lens.files import (
    OWN_SUFFIX,
    colmap_camera,
    load_camera,
    nerfstudio_camera,
)
from gsut.lens.files.colmap import PARAMETER_COUNTS, colmap_record
from gsut.lens.files.euroc import format_euroc
from gsut.lens.files.kalibr import is_camchain
from gsut.lens.files.nerfstudio import LENS_FILE, format_nerfstudio, frame_lens
from gsut.lens.files.own import camera_from_values, camera_values
from gsut.lens.fit_spline import SplineGrid, fit_control_points
from gsut.lens.refinable import refinable_params
from gsut.lens.uncertainty import grid_pixels, save_uncertainty

__all__ = [
    "LENS_FILE",
    "OWN_SUFFIX",
    "PARAMETER_COUNTS",
    "CalibrationWeights",
    "Camera",
    "Conversion",
    "LensProfile",
    "SplineGrid",
    "camera_from_values",
    "camera_models",
    "camera_values",
    "colmap_camera",
    "colmap_record",
    "convert_camera",
    "field_of_view",
    "find_lenses",
    "fit_control_points",
    "focal_params",
    "format_conversion",
    "format_euroc",
    "format_nerfstudio",
    "frame_lens",
    "grid_pixels",
    "has_focal_length",
    "is_camchain",
    "is_lens_name",
    "lens_by_name",
    "load_camera",
    "load_lens",
    "nerfstudio_camera",
    "refinable_params",
    "save_uncertainty",
    "with_field_of_view",
    "with_scaled_focal",
]
