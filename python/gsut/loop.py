"""More parts of a training loop of your own: seeding, densification, rates, low-pass filter."""

from gsut.gaussians import (
    apply_low_pass,
    apply_low_pass_backward,
    find_filter_radii,
    seed_in_view,
)
from gsut.optimize import LearningRates, densify_adaptive, densify_mcmc, learning_rates
from gsut.render import render_surface_backward

__all__ = [
    "LearningRates",
    "apply_low_pass",
    "apply_low_pass_backward",
    "densify_adaptive",
    "densify_mcmc",
    "find_filter_radii",
    "learning_rates",
    "render_surface_backward",
    "seed_in_view",
]
