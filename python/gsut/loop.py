"""More parts of a training loop of your own: seeding, densification, rates."""

from gsut.gaussians import seed_in_view
from gsut.optimize import (
    LearningRates,
    compute_learning_rates,
    densify_adaptive,
    densify_mcmc,
)
from gsut.render import render_surface_backward

__all__ = [
    "LearningRates",
    "compute_learning_rates",
    "densify_adaptive",
    "densify_mcmc",
    "render_surface_backward",
    "seed_in_view",
]
