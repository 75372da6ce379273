"""More parts of a training loop of your own: seeding, densification, rates, low-pass filter."""

from gsut.gaussians import (
    apply_low_pass,
    apply_low_pass_backward,
    find_filter_radii,
    seed_in_view,
)
from gsut.optimize import (
    LearningRates,
    compute_learning_rates,
    densify_adaptive,
    densify_mcmc,
)
from gsut.render import render_surface_backward

__all__ = [
    "LearningRates",
    "apply_low_pass",
    "apply_low_pass_backward",
    "compute_learning_rates",
    "densify_adaptive",
    "densify_mcmc",
    "find_filter_radii",
    "render_surface_backward",
    "seed_in_view",
]
