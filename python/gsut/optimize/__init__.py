"""Adam over growing Gaussians, schedules, the mean of the trajectory."""

from gsut.optimize.densify import densify_adaptive, densify_mcmc, split_and_prune
from gsut.optimize.optimizer import GaussianOptimizer, LearningRates
from gsut.optimize.schedule import (
    DENSIFY_FROM,
    DENSIFY_UNTIL,
    choose_view,
    compute_learning_rates,
    compute_target_size,
    find_last_densification,
)
from gsut.optimize.trajectory_mean import TrajectoryMean
