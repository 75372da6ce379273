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
    measure_pixel_angle,
    spread_pixels,
    with_field_of_view,
    with_scaled_focal,
)
from gsut.lens.files import camera_from_info, info_from_camera, load_camera, save_camera
from gsut.lens.fit_rays import fit_camera
from gsut.lens.fit_spline import fit_control_points
from gsut.lens.focal_prior import FocalPrior
from gsut.lens.plausible import MOST_STRETCH
from gsut.lens.refinable import find_refinable_params
