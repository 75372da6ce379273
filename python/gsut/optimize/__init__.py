"""Adam over growing Gaussians, schedules, the mean of the trajectory."""

from gsut.optimize.densify import densify_adaptive, densify_mcmc, split_and_prune
from gsut.optimize.optimizer import GaussianOptimizer, LearningRates
from gsut.optimize.packed_optimizer import optimizer_of
from gsut.optimize.schedule import (
    grown_count,
    last_densification,
    learning_rates,
    view_of_step,
)
from gsut.optimize.trajectory_mean import TrajectoryMean

__all__ = [
    "GaussianOptimizer",
    "LearningRates",
    "TrajectoryMean",
    "densify_adaptive",
    "densify_mcmc",
    "grown_count",
    "last_densification",
    "learning_rates",
    "optimizer_of",
    "split_and_prune",
    "view_of_step",
]
