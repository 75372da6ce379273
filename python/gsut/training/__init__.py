"""Trains a scene: what comes before the first step, the steps, and what a run writes.

Rooms of their own, whose doors anyone may use: `first`, `record` and `tuning`.
"""

from gsut.training.degree_trial import choose_degree
from gsut.training.loop import TrainingLoop
from gsut.training.record import (
    TrainedRun,
    load_run,
    open_trained,
    read_light,
    read_scene,
    read_trained,
)
