"""The readout time of a shutter from a solution that knows of none, by one step of Gauss-Newton.

How fast the camera moved in each image is known from the flow of the video, so that a rolling
shutter has one unknown: its readout time. Poses, points and the lens are free beside it: what they
can take up is no evidence. Velocities of each image's own would bend the scene instead (Albl et
al., "Degeneracies in rolling shutter SfM", ECCV 2016). Errors of the velocities make the time look
shorter, by a share that is found (Fuller, "Measurement Error Models", 1987, section 1.2). Residuals
of an image, and of those after it, err alike: the standard deviation is that of independent groups
of images (Liang and Zeger, "Longitudinal data analysis using generalized linear models", 1986).
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from gsut.data.poses import find_centers
from gsut.sfm.core import FEATURE_VARIANCE, Solution, in_cameras
from gsut.sfm.lens import by_turn, free_columns, residual_spread, without_points

_TINY = 1e-300
_GROUPS = 8  # of images
_DRAWS = 4  # of the velocities' errors
_LEAST_RELIABLE = 0.5  # errors that are more than half of what was found are not known so well


@dataclasses.dataclass(frozen=True)
class FlowReadout:
    """A readout time in seconds, and its standard deviation.

    Args:
        time, sigma: of it.
        reliability: share of the velocities' squares that is no error: times come out shorter by
            that.
    """

    time: float
    sigma: float
    reliability: float = 1.0

    @property
    def clearness(self) -> float:
        """Standard deviations from nothing."""
        return abs(self.time) / self.sigma


def readout_by_flow(
    solution: Solution,
    rates: np.ndarray,
    spread: np.ndarray,
    along_y: bool,
    lens_free: np.ndarray | None,
    loss_scale: float,
) -> FlowReadout | None:
    """The readout time that the residuals of a solution ask for.

    Args:
        solution: with one lens, all lines of an image read at once.
        rates, spread: (N, 6) velocities in a second, (N, 6, 6) their covariances, see
            `rates_of_frames`; NaN: image not looked at.
        along_y: lines are read from top to bottom, else from left to right.
        lens_free: see `solve`.
        loss_scale: of Cauchy's loss, as in the adjustment.

    Returns:
        The time, below 0 for lines read in the other order; None where it is not determined.
    """
    camera = solution.cameras[0]
    image, point = solution.observations[:, 1], solution.observations[:, 0]
    known = solution.registered & np.isfinite(rates).all(axis=1)
    p = in_cameras(solution.points, solution.observations, solution.camera_from_world)
    by_p, by_params = camera.project_jacobian(p)
    good = np.isfinite(by_p).all(axis=(1, 2)) & np.isfinite(solution.residuals).all(axis=1)
    good &= known[image]
    good &= np.bincount(point, weights=good, minlength=len(solution.points))[point] > 1
    image, point, p, by_p = image[good], point[good], p[good], by_p[good]
    rotation, residual = solution.camera_from_world[image, :3, :3], solution.residuals[good]
    squared = np.sum(residual**2, axis=1)
    if not len(squared):
        return None
    scale = loss_scale * max(math.sqrt(float(np.median(squared))), 1e-12)
    weight = np.sqrt(1 / (1 + squared / scale**2))[:, None, None]
    size = camera.height if along_y else camera.width
    line = solution.pixels[good, int(along_y)] / size - 0.5
    # dp / d(time): the centre moves in the world, and the camera turns. A column for each group of
    # images, whose sum is that of the time, and some of what errors of the velocities look like.
    group = _groups(known)
    columns = []
    for rate in (rates, *_errors(spread, known)):
        moves = np.cross(rate[image, 3:], p) - np.einsum("nij,nj->ni", rotation, rate[image, :3])
        columns.append(by_p @ (line[:, None] * moves)[:, :, None])
    grouped = columns[0] * (group[image][:, None] == np.arange(_GROUPS))[:, None, :]
    columns = [grouped, *columns[1:], residual[:, :, None]]
    times = _GROUPS + _DRAWS + 1
    if lens_free is not None:
        columns.insert(0, by_params[good] @ free_columns(lens_free))
    by_centre = -by_p @ rotation
    rows = weight * np.concatenate([by_centre, by_turn(by_p, p)], axis=2)
    normal, freedom = without_points(
        image, point, rows, weight * np.concatenate(columns, axis=2), -weight * by_centre,
        len(known),
    )  # fmt: skip
    unknown = _unknowns(solution, known, len(normal) - times)
    freedom += 2 * len(image) - len(unknown) - 1
    small = normal[np.ix_(unknown, unknown)]
    length = 1 / np.sqrt(np.maximum(np.diag(small), _TINY))
    cross = normal[unknown, -times:] * length[:, None]
    try:
        taken_up = cross.T @ np.linalg.solve(small * np.outer(length, length), cross)
    except np.linalg.LinAlgError:
        return None
    left = normal[-times:, -times:] - taken_up
    information = float(left[:_GROUPS, :_GROUPS].sum())
    if freedom <= 0 or not information > 0:
        return None
    time = -float(left[:_GROUPS, -1].sum()) / information
    factor = residual_spread(squared, weight[:, 0, 0] ** 2, freedom)[1] * FEATURE_VARIANCE
    scores = left[:_GROUPS, -1] + left[:_GROUPS, :_GROUPS].sum(axis=1) * time
    apart = _GROUPS / (_GROUPS - 1) * float(scores @ scores) / information**2
    noise = float(np.diag(left)[_GROUPS:-1].mean())
    return FlowReadout(
        time, math.sqrt(max(factor / information, apart)),
        max(1 - noise / information, _LEAST_RELIABLE),
    )  # fmt: skip


def _groups(known: np.ndarray) -> np.ndarray:
    """(N,) which of `_GROUPS` groups of successive images each image is in."""
    order = np.cumsum(known) - 1
    return np.clip(order * _GROUPS // max(1, int(known.sum())), 0, _GROUPS - 1)


def _errors(spread: np.ndarray, known: np.ndarray) -> list[np.ndarray]:
    """Velocities (N, 6) as their errors are distributed, some draws."""
    rng = np.random.default_rng(0)
    values, axes = np.linalg.eigh(np.where(known[:, None, None], np.nan_to_num(spread), 0.0))
    roots = axes * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    draws = rng.standard_normal((_DRAWS, len(known), 6))
    return [np.einsum("nij,nj->ni", roots, draw) for draw in draws]


def _unknowns(solution: Solution, known: np.ndarray, size: int) -> np.ndarray:
    """Indices of what the gauge leaves free of so many unknowns."""
    images = np.flatnonzero(known)
    centres = find_centers(solution.camera_from_world)
    away = centres[images] - centres[images[0]]
    second = int(images[np.argmax((away**2).sum(axis=1))])
    axis = int(np.argmax(np.abs(centres[second] - centres[images[0]])))
    keep = np.ones(size, bool)
    keep[: 6 * len(known)] = np.repeat(known, 6)
    keep[6 * images[0] : 6 * images[0] + 6] = False
    keep[6 * second + axis] = False
    return np.flatnonzero(keep)
