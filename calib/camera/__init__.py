"""One camera: its solved lens, projection through it, rigid transforms and bundle adjustment."""

from calib.camera.bundle import (
    Observation,
    Projector,
    State,
    estimate_covariance,
    minimize,
    observe_boards,
)
from calib.camera.projection import (
    PIXEL_SHIFT,
    make_gsut_projector,
    make_projector,
    parse_splined_name,
    project_radially,
    to_gsut_camera,
    unproject_pixels,
)
from calib.camera.rigid import (
    compose,
    cross_matrix_from_vector,
    invert,
    matrix_from_rodrigues,
    measure_rotation_angle,
    rodrigues_from_matrix,
    transform_points,
)
from calib.camera.solution import LENSES, CameraSolution, find_outliers

__all__ = [
    "LENSES",
    "PIXEL_SHIFT",
    "CameraSolution",
    "Observation",
    "Projector",
    "State",
    "compose",
    "cross_matrix_from_vector",
    "estimate_covariance",
    "find_outliers",
    "invert",
    "make_gsut_projector",
    "make_projector",
    "matrix_from_rodrigues",
    "measure_rotation_angle",
    "minimize",
    "observe_boards",
    "parse_splined_name",
    "project_radially",
    "rodrigues_from_matrix",
    "to_gsut_camera",
    "transform_points",
    "unproject_pixels",
]
