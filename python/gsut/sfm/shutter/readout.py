"""Estimates a readout time from the velocities of a video's frames, or from residuals and flow.

From a solution with a rolling shutter the time follows from its velocities. From one without it is
found by one step of Gauss-Newton: the flow of the video shows how fast the camera moved in each
image, so that a rolling shutter has one unknown, its readout time. Poses, points and the lens are
free too: what they can explain is no evidence. A free velocity for each image would bend the scene
instead (Albl et al., "Degeneracies in rolling shutter SfM", ECCV 2016). Errors of the velocities
make the time look shorter by a share that is estimated (Fuller, "Measurement Error Models", 1987,
section 1.2). Residuals of successive images are correlated: the standard deviation is that of
independent groups of images (Liang and Zeger, "Longitudinal data analysis using generalized linear
models", 1986).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence

import numpy as np

from gsut import _core
from gsut.data.poses import find_centers
from gsut.lens import Camera
from gsut.sfm.lens import (
    differentiate_by_turn,
    eliminate_by_windows,
    eliminate_points,
    estimate_residual_spread,
    spread_free_parameters,
)
from gsut.sfm.solution import (
    FEATURE_VARIANCE,
    Solution,
    index_lenses,
    order_by_folder,
    transform_to_cameras,
)

_MOST_IMAGES = 400  # at once; of more the information is added up over windows
_FEWEST_FRAMES = 6  # with neighbours: fewer do not show how well the time explains them
_LEAST_EXPLAINED = 0.5  # of the velocities' squares, below which the frames are no video
_TINY = 1e-300  # keeps quotients finite
_GROUPS = 8  # of successive images, taken to err independently
_DRAWS = 4  # of the velocities' errors: their mean is known to a fifth
_LEAST_RELIABLE = 0.5  # larger errors of the velocities are not known well enough
_FEWEST_CORNERS = 8  # of known depth: six unknowns and some to judge them by
_NEAR = 0.08  # of the diagonal: farther points do not show the depth of a corner
_NEAREST = 3  # points that the depth of a corner is taken from
_ROUNDS = 10  # of robust weights: they have settled after five or six
_STEP = 1e-4  # of the central differences, in radians and shares of the median distance


@dataclasses.dataclass(frozen=True)
class ReadoutTime:
    """A readout time and how well it explains the velocities.

    Args:
        time: from the first line to the last, as a share of the time between two frames.
        explained: share of the velocities' squares that this time explains, at most 1.
    """

    time: float
    explained: float


def estimate_readout_time(names: Sequence[str], solution: Solution) -> ReadoutTime | None:
    """Estimates the readout time that best relates motion between frames to that within them.

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
    times, folders = order_by_folder(names)
    readouts = np.ones(len(times)) if solution.lines is None else solution.lines.readouts
    own, between = [], []
    for folder in range(int(folders.max(initial=-1)) + 1):
        wanted = solution.registered & (folders == folder) & (readouts > 0)
        order = [int(i) for i in np.argsort(times, kind="stable") if wanted[i]]
        for before, image, after in zip(order, order[1:], order[2:], strict=False):
            middle = solution.camera_from_world[[before, after]]
            between.append(_core.velocity_between(*middle) / (times[after] - times[before]))
            own.append(solution.velocities[image] / readouts[image])
    if len(own) < _FEWEST_FRAMES:
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


@dataclasses.dataclass(frozen=True)
class FlowReadout:
    """A readout time in seconds, and its standard deviation.

    Args:
        time: seconds from the first line to the last.
        sigma: its standard deviation.
        reliability: share of the velocities' squares that is no error; estimated times are too
            short by this factor.
    """

    time: float
    sigma: float
    reliability: float = 1.0

    @property
    def clearness(self) -> float:
        """Standard deviations from nothing."""
        return abs(self.time) / self.sigma


def estimate_readout_by_flow(
    solution: Solution,
    rates: np.ndarray,
    spread: np.ndarray,
    times: np.ndarray,
    lens_free: np.ndarray | None,
    loss_scale: float,
) -> FlowReadout | None:
    """Estimates the readout time that explains the residuals of a solution best.

    Args:
        solution: lines as far as they are taken into account.
        rates, spread: (N, 6) velocities per second, (N, 6, 6) their covariances, see
            `estimate_rates`; NaN: image not used.
        times: (S,) when the lines of the observations are read, see `measure_line_times`.
        lens_free: flags of the one lens, see `Adjustment`; None: lenses are known.
        loss_scale: of Cauchy's loss, as in the adjustment.

    Returns:
        The time of the longest readout, below 0 for lines read in the other order; None where it is
        not determined.
    """
    image, point = solution.observations[:, 1], solution.observations[:, 0]
    known = solution.registered & np.isfinite(rates).all(axis=1)
    p = transform_to_cameras(solution.points, solution.observations, solution.camera_from_world)
    by_p, by_params = _differentiate_projection(solution, p)
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
    line = times[good]
    # dp / d(time): the centre moves in the world, and the camera turns. A column for each group of
    # images, whose sum is that of the time, and some of what errors of the velocities look like.
    group = _assign_groups(known)
    motions = [rates, *_draw_errors(spread, known)]
    last = _GROUPS + _DRAWS + 1
    by_lens = None if lens_free is None else by_params[good] @ spread_free_parameters(lens_free)

    def differentiate(rows: np.ndarray | slice) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Returns the weighted derivatives of some observations by poses, what is asked, points."""
        columns = []
        for rate in motions:
            turned = np.cross(rate[image[rows], 3:], p[rows])
            moves = turned - np.einsum("nij,nj->ni", rotation[rows], rate[image[rows], :3])
            columns.append(by_p[rows] @ (line[rows, None] * moves)[:, :, None])
        grouped = columns[0] * (group[image[rows]][:, None] == np.arange(_GROUPS))[:, None, :]
        columns = [grouped, *columns[1:], residual[rows, :, None]]
        if by_lens is not None:
            columns.insert(0, by_lens[rows])
        by_centre = -by_p[rows] @ rotation[rows]
        by_pose = np.concatenate([by_centre, differentiate_by_turn(by_p[rows], p[rows])], axis=2)
        each = weight[rows]
        return each * by_pose, each * np.concatenate(columns, axis=2), -each * by_centre

    if known.sum() > _MOST_IMAGES:
        centers = find_centers(solution.camera_from_world)
        normal, freedom = eliminate_by_windows(image, point, centers, differentiate, np.zeros(6))
        unknown = np.arange(len(normal) - last)
    else:
        normal, freedom = eliminate_points(image, point, *differentiate(slice(None)), len(known))
        unknown = _find_unknowns(solution, known, len(normal) - last)
    freedom += 2 * len(image) - len(unknown) - 1
    small = normal[np.ix_(unknown, unknown)]
    length = 1 / np.sqrt(np.maximum(np.diag(small), _TINY))
    cross = normal[unknown, -last:] * length[:, None]
    try:
        taken_up = cross.T @ np.linalg.solve(small * np.outer(length, length), cross)
    except np.linalg.LinAlgError:
        return None
    left = normal[-last:, -last:] - taken_up
    information = float(left[:_GROUPS, :_GROUPS].sum())
    if freedom <= 0 or not information > 0:
        return None
    time = -float(left[:_GROUPS, -1].sum()) / information
    factor = estimate_residual_spread(squared, weight[:, 0, 0] ** 2, freedom)[1] * FEATURE_VARIANCE
    scores = left[:_GROUPS, -1] + left[:_GROUPS, :_GROUPS].sum(axis=1) * time
    apart = _GROUPS / (_GROUPS - 1) * float(scores @ scores) / information**2
    noise = float(np.diag(left)[_GROUPS:-1].mean())
    return FlowReadout(
        time, math.sqrt(max(factor / information, apart)),
        max(1 - noise / information, _LEAST_RELIABLE),
    )  # fmt: skip


def _differentiate_projection(solution: Solution, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns (S, 2, 3) and (S, 2, K) derivatives of the observations by points and lens.

    Those by the lens are of one lens only; of several they are empty.
    """
    lenses = index_lenses(solution.cameras, None)
    if len(lenses.cameras) == 1:
        return lenses.cameras[0].project_jacobian(p)
    by_p = np.zeros((len(p), 2, 3))
    of_lens = np.array(lenses.of_image)[solution.observations[:, 1]]
    for number, camera in enumerate(lenses.cameras):
        by_p[of_lens == number] = camera.project_jacobian(p[of_lens == number])[0]
    return by_p, np.zeros((len(p), 2, 0))


def _assign_groups(known: np.ndarray) -> np.ndarray:
    """Returns (N,) the group of successive images that each image is in."""
    order = np.cumsum(known) - 1
    return np.clip(order * _GROUPS // max(1, int(known.sum())), 0, _GROUPS - 1)


def _draw_errors(spread: np.ndarray, known: np.ndarray) -> list[np.ndarray]:
    """Draws errors of the velocities (N, 6) from their covariances."""
    rng = np.random.default_rng(0)
    values, axes = np.linalg.eigh(np.where(known[:, None, None], np.nan_to_num(spread), 0.0))
    roots = axes * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    draws = rng.standard_normal((_DRAWS, len(known), 6))
    return [np.einsum("nij,nj->ni", roots, draw) for draw in draws]


def _find_unknowns(solution: Solution, known: np.ndarray, size: int) -> np.ndarray:
    """Returns the indices of the unknowns that the gauge leaves free."""
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


def estimate_rates(
    solution: Solution, flows: Mapping[str, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Estimates the velocities of the images, as in `Solution.velocities` but per second.

    Args:
        solution: poses and points, which may be those of a global shutter.
        flows: by name of the image (M, 4): pixels, and how far they move in a second.

    Returns:
        (N, 6), and covariances (N, 6, 6) from the residuals of the flow; NaN where an image has no
        pose or too little flow.
    """
    rates = np.full((len(solution.names), 6), np.nan)
    covariances = np.full((len(solution.names), 6, 6), np.nan)
    depths = transform_to_cameras(
        solution.points, solution.observations, solution.camera_from_world
    )
    distances = np.linalg.norm(depths, axis=1)
    for image in np.flatnonzero(solution.registered):
        flow = flows.get(solution.names[image])
        if flow is None:
            continue
        seen = solution.observations[:, 1] == image
        distance = _find_distances(solution.pixels[seen], distances[seen], flow[:, :2],
                              solution.cameras[image])  # fmt: skip
        rates[image], covariances[image] = _fit_rate(
            solution.camera_from_world[image], solution.cameras[image], flow, distance
        )
    return rates, covariances


def _find_distances(
    pixels: np.ndarray, distances: np.ndarray, at: np.ndarray, camera: Camera
) -> np.ndarray:
    """Returns (M,) the distances of what is seen at pixels (M, 2), by points nearby, or NaN."""
    if len(pixels) < _NEAREST:
        return np.full(len(at), np.nan)
    away = np.linalg.norm(at[:, None] - pixels[None], axis=2)
    nearest = np.argsort(away, axis=1, kind="stable")[:, :_NEAREST]
    near = np.take_along_axis(away, nearest, axis=1)[:, -1]
    found = np.median(distances[nearest], axis=1)
    return np.where(near < _NEAR * np.hypot(camera.width, camera.height), found, np.nan)


def _fit_rate(
    camera_from_world: np.ndarray, camera: Camera, flow: np.ndarray, distance: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Fits (6,) a velocity by robust least squares, and its covariance (6, 6), or NaN."""
    unknown = np.full(6, np.nan), np.full((6, 6), np.nan)
    rays, valid = camera.unproject(flow[:, :2])
    good = valid & np.isfinite(distance)
    if good.sum() < _FEWEST_CORNERS:
        return unknown
    points, speed = rays[good] * distance[good, None], flow[good, 2:]
    columns = []
    middle = float(np.median(distance[good]))
    for axis in range(6):
        moves = []
        for sign in (1, -1):
            change = np.zeros(3)
            change[axis % 3] = sign * _STEP
            # The centre moves in the world, and the camera turns: p <- exp(w) (p - R v).
            moved = (
                points - middle * camera_from_world[:3, :3] @ change
                if axis < 3
                else points + np.cross(change, points)
            )
            moves.append(camera.project(moved)[0])
        scale = middle if axis < 3 else 1.0
        columns.append((moves[0] - moves[1]) / (2 * _STEP * scale))
    matrix = np.stack(columns, axis=2)  # (M, 2, 6) pixels
    kept = np.isfinite(matrix).all(axis=(1, 2))
    matrix, speed = matrix[kept], speed[kept]
    if len(matrix) < _FEWEST_CORNERS:
        return unknown
    # Shifts and turns of a size: the normal equations stay well scaled.
    size = np.array([1 / middle] * 3 + [1.0] * 3)
    weight = np.ones(len(matrix))
    for _ in range(_ROUNDS):
        root = np.sqrt(weight)[:, None]
        left = (root[:, :, None] * matrix / size).reshape(-1, 6)
        found = np.linalg.lstsq(left, (root * speed).ravel(), rcond=None)[0] / size
        off = np.linalg.norm(speed - matrix @ found, axis=1)
        weight = 1 / (1 + (off / max(float(np.median(off)), 1e-9)) ** 2)
    variance = float(np.median(off)) ** 2 / (2 * math.log(2)) * len(matrix) / (len(matrix) - 3)
    normal = left.T @ left
    return found, variance * np.linalg.pinv(normal) / np.outer(size, size)
