"""A scene's Gaussians: arrays, seeding, editing, pixel sizes."""

from gsut.gaussians.arrays import SH_C0, Gaussians, LinearGaussians
from gsut.gaussians.cone import OPAQUE
from gsut.gaussians.cut import (
    find_ground,
    merge_gaussians,
)
from gsut.gaussians.morton import order_by_morton_code
from gsut.gaussians.pixel_size import compute_pixel_density, find_pixel_sizes
from gsut.gaussians.quaternions import (
    find_nearest_rotation,
    find_rotation_vectors,
    measure_rotation_angles,
    multiply_quaternions,
    quaternion_from_rotation,
    rotations_from_quaternions,
)
from gsut.gaussians.seeding import COLOR_ROUNDING, choose_points, seed_from_points, seed_in_view
from gsut.gaussians.similarity import rotate_upright, transform_gaussians
from gsut.gaussians.stored import (
    StoredGaussians,
    count_bytes_per_gaussian,
)
from gsut.gaussians.surfels import press_surfels
