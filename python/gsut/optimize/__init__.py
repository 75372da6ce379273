"""Adam over growing Gaussians, schedules, the mean of the trajectory."""

from gsut.optimize.optimizer import GaussianOptimizer, LearningRates
from gsut.optimize.packed_optimizer import optimizer_of
from gsut.optimize.schedule import grown_count, learning_rates, view_of_step
from gsut.optimize.trajectory_mean import TrajectoryMean

__all__ = [
    "GaussianOptimizer",
    "LearningRates",
    "TrajectoryMean",
    "grown_count",
    "learning_rates",
    "optimizer_of",
    "view_of_step",
]
