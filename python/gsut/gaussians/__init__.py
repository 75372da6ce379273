"""The scene's parameters: arrays, packed harmonics, seeding, the low-pass filter."""

from gsut.gaussians.arrays import SH_C0, Gaussians
from gsut.gaussians.cut import ground_of, inside_box, inside_sphere, merged, seen_most
from gsut.gaussians.low_pass import (
    LowPassFilter,
    filter_radii,
    low_pass,
    low_pass_backward,
    pixel_density,
)
from gsut.gaussians.morton import morton_order
from gsut.gaussians.packed_harmonics import MixedGaussians, pack_harmonics, to_mixed
from gsut.gaussians.quaternions import (
    quaternion_of,
    quaternion_products,
    rotations_backward,
    rotations_of,
)
from gsut.gaussians.seeding import chosen_points, seed_from_points, seed_in_view
from gsut.gaussians.similarity import transformed, upright
from gsut.gaussians.stored import (
    DRAWN_BYTES,
    LEAST_ALPHA,
    StoredGaussians,
    bytes_each,
    order_for_reading,
)
from gsut.gaussians.surfels import are_surfels, press_surfels, to_surfels

__all__ = [
    "DRAWN_BYTES",
    "LEAST_ALPHA",
    "SH_C0",
    "Gaussians",
    "LowPassFilter",
    "MixedGaussians",
    "StoredGaussians",
    "are_surfels",
    "bytes_each",
    "chosen_points",
    "filter_radii",
    "ground_of",
    "inside_box",
    "inside_sphere",
    "low_pass",
    "low_pass_backward",
    "merged",
    "morton_order",
    "order_for_reading",
    "pack_harmonics",
    "pixel_density",
    "press_surfels",
    "quaternion_of",
    "quaternion_products",
    "rotations_backward",
    "rotations_of",
    "seed_from_points",
    "seed_in_view",
    "seen_most",
    "to_mixed",
    "to_surfels",
    "transformed",
    "upright",
]
