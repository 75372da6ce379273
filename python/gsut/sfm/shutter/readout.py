"""The readout time of a video's rolling shutter, from the velocities found for its frames."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from gsut import _core
from gsut.data.scene import order_frames
from gsut.sfm.core import Solution

_FEWEST = 6  # frames with neighbours: fewer say nothing about how well the time explains them
_LEAST_EXPLAINED = 0.5  # of the velocities' squares, below which the frames are no video


@dataclasses.dataclass(frozen=True)
class ReadoutTime:
    """What the velocities say.

    Args:
        time: from the first line to the last, over the time between two frames.
        explained: share of the velocities' squares that this time explains, at most 1.
    """

    time: float
    explained: float


def readout_time(names: Sequence[str], solution: Solution) -> ReadoutTime | None:
    """The readout time that carries the motion between frames to that within them best.

    Turns and shifts count alike: each is divided by its root mean square. By least squares with
    weights that fall off for frames that do not fit (a jerk between frames is no velocity).

    Args:
        names: of the images; the last number of each counts the frames.
        solution: with a rolling shutter.

    Returns:
        None for a global shutter, for too few frames, or if no time explains the velocities: the
        images are then no video, or their numbers do not count its frames.
    """
    if solution.velocities is None:
        return None
    times = order_frames(names)
    order = [int(i) for i in np.argsort(times, kind="stable") if solution.registered[i]]
    own, between = [], []
    for before, image, after in zip(order, order[1:], order[2:], strict=False):
        middle = solution.camera_from_world[[before, after]]
        between.append(_core.velocity_between(*middle) / (times[after] - times[before]))
        own.append(solution.velocities[image])
    if len(own) < _FEWEST:
        return None
    x, y = np.array(between).reshape(-1, 2, 3), np.array(own).reshape(-1, 2, 3)
    size = np.sqrt((y**2).sum(axis=2).mean(axis=0)).reshape(1, 2, 1)
    if not (size > 0).all():
        return None
    x, y = (x / size).reshape(-1, 6), (y / size).reshape(-1, 6)
    weight = np.ones(len(x))
    time = 0.0
    for _ in range(20):
        time = float((weight * (x * y).sum(axis=1)).sum() / (weight * (x**2).sum(axis=1)).sum())
        squared = ((y - time * x) ** 2).sum(axis=1)
        weight = 1 / (1 + squared / max(float(np.median(squared)), 1e-12))
    explained = 1 - float(np.median(squared) / np.median((y**2).sum(axis=1)))
    if explained < _LEAST_EXPLAINED or time <= 0:
        return None
    return ReadoutTime(time, explained)
