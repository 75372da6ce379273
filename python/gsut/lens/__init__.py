"""Any lens: `Camera`, fits and conversion, lens files."""

from gsut.lens.camera import Camera, camera_models
from gsut.lens.convert import Conversion, convert_camera
from gsut.lens.database import (
    LensProfile,
    find_lens,
    find_lenses,
    is_lens_name,
    load_lens,
)
from gsut.lens.field import (
    find_focal_params,
    has_focal_length,
    measure_field_of_view,
    spread_pixels,
    with_field_of_view,
    with_scaled_focal,
)
from gsut.lens.files import camera_from_info, info_from_camera, load_camera, save_camera
from gsut.lens.fit_rays import fit_camera
from gsut.lens.fit_spline import fit_control_points
from gsut.lens.focal_prior import FocalPrior
from gsut.lens.refinable import find_refinable_params

__all__ = [
    "Camera",
    "Conversion",
    "FocalPrior",
    "LensProfile",
    "camera_from_info",
    "camera_models",
    "convert_camera",
    "find_focal_params",
    "find_lens",
    "find_lenses",
    "find_refinable_params",
    "fit_camera",
    "fit_control_points",
    "has_focal_length",
    "info_from_camera",
    "is_lens_name",
    "load_camera",
    "load_lens",
    "measure_field_of_view",
    "save_camera",
    "spread_pixels",
    "with_field_of_view",
    "with_scaled_focal",
]
