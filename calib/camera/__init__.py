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
