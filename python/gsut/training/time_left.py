"""Predicts how long a training takes, from how its steps grow and how fast this machine is."""

from __future__ import annotations

import dataclasses
import statistics
import time

import numpy as np

from gsut import _core
from gsut.data import Scene
from gsut.gaussians import Gaussians
from gsut.lens import Camera
from gsut.optimize import compute_target_size
from gsut.run import TrainOptions
from gsut.time_left import Pace, predict_steps
from gsut.training.loop import RAY_FROM

CURVE_VIEWS = 4  # held-out views measured during a training: enough to see its course
# Gaussians of the picture that `measure_pace` draws and differentiates, and its pixels a side.
_PROBE_GAUSSIANS = 20_000
_PROBE_SIDE = 320
# Seconds that this takes on one core of the machine whose rates `gsut.time_left` holds.
_PROBE_SECONDS = 0.0116
# Time of a step along the ray over that of one by the distance (docs/approximations.md).
_RAY_FACTOR = 2.2
_PROBES = 5  # of which the median counts: other programs interrupt single ones


def measure_pace() -> float:
    """Measures how many times longer a core takes here than `gsut.time_left` expects.

    It draws and differentiates a picture on all threads in use, within about a tenth of a second,
    so processors that others use, or that a container withholds, count.
    """
    rng, shape, side = np.random.default_rng(0), (_PROBE_GAUSSIANS, 3), _PROBE_SIDE
    gaussians = Gaussians(
        rng.uniform((-1, -1, 2), (1, 1, 4), shape).astype(np.float32),
        rng.normal(size=(_PROBE_GAUSSIANS, 4)).astype(np.float32),
        rng.normal(-4.0, 0.5, shape).astype(np.float32),
        rng.normal(size=_PROBE_GAUSSIANS).astype(np.float32),
        rng.normal(0.0, 0.3, (_PROBE_GAUSSIANS, 4, 3)).astype(np.float32),
    )
    camera = Camera("pinhole", [0.8 * side, 0.8 * side, side / 2, side / 2], side, side)
    renderer, image = _core.Renderer(), np.empty((side, side, 3), np.float32)
    gradient, touched = np.full_like(image, 1e-3), np.zeros(_PROBE_GAUSSIANS, np.uint8)
    seconds, gradients = [], gaussians.make_zeros()
    for _ in range(1 + _PROBES):
        began = time.perf_counter()
        renderer.render(gaussians, _core.RenderJob(camera, np.eye(4), sh_degree=1), image)
        renderer.backward(gradient, gradients, touched, write_untouched=False, with_poses=False)
        seconds.append(time.perf_counter() - began)
    return statistics.median(seconds[1:]) * _core.num_threads() / _PROBE_SECONDS


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
    along_ray = (options.order == "ray") & (fraction >= RAY_FROM)
    return predict_steps(megapixels * area, counts) * np.where(along_ray, _RAY_FACTOR, 1.0)


def track_training(
    options: TrainOptions,
    first_count: int,
    megapixels: float,
    held_out: int,
    step: int = 0,
    threads: int = 1,
    pace: float = 1.0,
) -> Pace:
    """Starts to predict the time left of a training.

    Args:
        options, first_count, megapixels: see `predict_training_steps`.
        held_out: number of held-out views; measuring one takes as long as a step at full size.
        step: steps that an earlier run has made.
        threads: that share the work.
        pace: of this machine, see `measure_pace`.
    """
    work = predict_training_steps(options, first_count, megapixels)
    whole = dataclasses.replace(options, coarse_to_fine=(0.0, 0.0))
    full = predict_training_steps(whole, first_count, megapixels)
    if options.eval_every:
        is_due = np.arange(1, options.steps + 1) % options.eval_every == 0
        work = work + is_due * min(CURVE_VIEWS, held_out) * full
    rate = pace / max(1, threads)
    return Pace((rate * work).tolist(), rate * held_out * float(full[-1]), step)
