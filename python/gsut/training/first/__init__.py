"""What training decides before its first step: images, size of the model, first Gaussians."""

from gsut.training.first.complexity import choose_complexity
from gsut.training.first.fixed_pixels import describe_fixed
from gsut.training.first.gains import find_first_gains
from gsut.training.first.gains_in_time import interpolate_gains
from gsut.training.first.preparation import (
    center_on_cameras,
    describe_resizing,
    find_plain_background,
    prepare_scene,
    refine_first_poses,
)
from gsut.training.first.seeding import (
    choose_first_gaussians,
    seed_first,
)

__all__ = [
    "center_on_cameras",
    "choose_complexity",
    "choose_first_gaussians",
    "describe_fixed",
    "describe_resizing",
    "find_first_gains",
    "find_plain_background",
    "interpolate_gains",
    "prepare_scene",
    "refine_first_poses",
    "seed_first",
]
