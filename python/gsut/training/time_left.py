"""Predicts how long a training still takes, from how its steps grow."""

from __future__ import annotations

import dataclasses

import numpy as np

from gsut.data import Scene
from gsut.optimize import compute_target_size
from gsut.run import TrainOptions
from gsut.time_left import Pace, predict_steps

CURVE_VIEWS = 4  # held-out views measured during a training: enough to see its course


def measure_megapixels(scene: Scene) -> float:
    """Returns millions of pixels of a scene's photographs, the mean of its cameras."""
    return sum(c.width * c.height for c in scene.cameras) / len(scene.cameras) / 1e6


def predict_training_steps(
    options: TrainOptions, first_count: int, megapixels: float
) -> np.ndarray:
    """Predicts the seconds (S,) on one core of each step of a training.

    Args:
        options: resolved, with the number of Gaussians that the training will have.
        first_count: Gaussians at first.
        megapixels: of a training view at full size.
    """
    fraction = np.arange(1, options.steps + 1) / options.steps
    quarter, half = options.coarse_to_fine
    area = np.where(fraction <= quarter, 1 / 16, np.where(fraction <= half, 1 / 4, 1.0))
    counts = np.array([compute_target_size(options, max(1, first_count), f) for f in fraction])
    return predict_steps(megapixels * area, counts)


def track_training(
    options: TrainOptions,
    first_count: int,
    megapixels: float,
    held_out: int,
    step: int = 0,
    threads: int = 1,
) -> Pace:
    """Starts to predict the time left of a training.

    Args:
        options, first_count, megapixels: see `predict_training_steps`.
        held_out: number of held-out views; measuring one takes as long as a step at full size.
        step: steps that an earlier run has made.
        threads: that share the work.
    """
    work = predict_training_steps(options, first_count, megapixels)
    whole = dataclasses.replace(options, coarse_to_fine=(0.0, 0.0))
    full = predict_training_steps(whole, first_count, megapixels)
    if options.eval_every:
        is_due = np.arange(1, options.steps + 1) % options.eval_every == 0
        work = work + is_due * min(CURVE_VIEWS, held_out) * full
    work = work / max(1, threads)
    return Pace(work.tolist(), held_out * float(full[-1]) / max(1, threads), step)
