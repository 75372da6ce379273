"""What training decides before its first step: images, size of the model, first Gaussians."""

from gsut.training.first.complexity import choose_number
from gsut.training.first.fixed_pixels import describe_fixed
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
from gsut.training.first.sky import SKY_DISTANCE, measure_reach
