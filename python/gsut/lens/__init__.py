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
from gsut.lens.files import load_camera, save_camera
from gsut.lens.fit_rays import fit_camera
from gsut.lens.fit_spline import SplineGrid, fit_control_points
from gsut.lens.refinable import refinable_params
from gsut.lens.uncertainty import grid_pixels, save_uncertainty

__all__ = [
    "CalibrationWeights",
    "Camera",
    "Conversion",
    "LensProfile",
    "SplineGrid",
    "camera_models",
    "convert_camera",
    "field_of_view",
    "find_lenses",
    "fit_camera",
    "fit_control_points",
    "focal_params",
    "format_conversion",
    "grid_pixels",
    "has_focal_length",
    "is_lens_name",
    "lens_by_name",
    "load_camera",
    "load_lens",
    "refinable_params",
    "save_camera",
    "save_uncertainty",
    "with_field_of_view",
    "with_scaled_focal",
]
