"""Estimates a readout time from the residuals and the flow of a video.

It is found by one step of Gauss-Newton: the flow of the video shows how fast the camera moved in
each image, so that a rolling shutter has one unknown, its readout time. Poses, points and the lens
are free too: what they can explain is no evidence. A free velocity for each image would bend the
scene instead (Albl et al., "Degeneracies in rolling shutter SfM", ECCV 2016). Errors of the
velocities make the time look shorter by a share that is estimated (Fuller, "Measurement Error
Models", 1987, section 1.2). Residuals of successive images are correlated: the standard deviation
is that of independent groups of images (Liang and Zeger, "Longitudinal data analysis using
generalized linear models", 1986).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping

import numpy as np

from gsut.least_squares import ROUNDS
from gsut.lens import Camera
from gsut.sfm.lens import GROUPS, WeightedObservations, differentiate_by_turn, invert_scaled
from gsut.sfm.photographs import HELD_BY
from gsut.sfm.solution import FEATURE_VARIANCE, Solution, transform_to_cameras

_DRAWS = 4  # of the velocities' errors: their mean is known to a fifth
_LEAST_RELIABLE = 0.5  # larger errors of the velocities are not known well enough
_FEWEST_CORNERS = 8  # of known depth: six unknowns and some to judge them by
_NEAR = 0.08  # of the diagonal: farther points do not show the depth of a corner


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
) -> FlowReadout | None:
    """Estimates the readout time that explains the residuals of a solution best.

    Args:
        solution: lines as far as they are taken into account.
        rates, spread: (N, 6) velocities per second, (N, 6, 6) their covariances, see
            `estimate_rates`; NaN: image not used.
        times: (S,) when the lines of the observations are read, see `measure_line_times`.
        lens_free: flags of the one lens, see `Adjustment`; None: lenses are known.

    Returns:
        The time of the longest readout, below 0 for lines read in the other order; None where it is
        not determined.
    """
    known = solution.registered & np.isfinite(rates).all(axis=1)
    used = known[solution.observations[:, 1]]
    seen = WeightedObservations(solution, lens_free, used)
    if not len(seen.rows):
        return None
    rotation, line = solution.camera_from_world[:, :3, :3], times[seen.rows]
    # dp / d(time): the centre moves in the world, and the camera turns. A column for each group of
    # images, whose sum is that of the time, and some of what errors of the velocities look like.
    group = _assign_groups(known)
    motions = [rates, *_draw_errors(spread, known)]
    last = GROUPS + _DRAWS + 1

    def differentiate(rows: np.ndarray) -> np.ndarray:
        """Returns the weighted derivatives of some observations by lens, times and residual."""
        image, columns = seen.image[rows], []
        for rate in motions:
            moves = np.cross(rate[image, 3:], seen.p[rows])
            moves -= np.einsum("nij,nj->ni", rotation[image], rate[image, :3])
            columns.append(seen.by_p[rows] @ (line[rows, None] * moves)[:, :, None])
        columns[0] = columns[0] * (group[image][:, None] == np.arange(GROUPS))[:, None, :]
        residual = solution.residuals[seen.rows[rows], :, None]
        return seen.weight[rows] * np.concatenate([seen.by_lens[rows], *columns, residual], axis=2)

    normal, freedom = seen.find_information(differentiate, np.zeros(6))
    lens = len(normal) - last
    freedom -= lens + 1
    cross = normal[:lens, -last:]
    left = normal[-last:, -last:] - cross.T @ invert_scaled(normal[:lens, :lens]) @ cross
    information = float(left[:GROUPS, :GROUPS].sum())
    if freedom <= 0 or not information > 0:
        return None
    time = -float(left[:GROUPS, -1].sum()) / information
    factor = seen.estimate_spread(freedom) * FEATURE_VARIANCE
    scores = left[:GROUPS, -1] + left[:GROUPS, :GROUPS].sum(axis=1) * time
    apart = GROUPS / (GROUPS - 1) * float(scores @ scores) / information**2
    noise = float(np.diag(left)[GROUPS:-1].mean())
    return FlowReadout(
        time, math.sqrt(max(factor / information, apart)),
        max(1 - noise / information, _LEAST_RELIABLE),
    )  # fmt: skip


def _assign_groups(known: np.ndarray) -> np.ndarray:
    """Returns (N,) the group of successive images that each image is in."""
    order = np.cumsum(known) - 1
    return np.clip(order * GROUPS // max(1, int(known.sum())), 0, GROUPS - 1)


def _draw_errors(spread: np.ndarray, known: np.ndarray) -> list[np.ndarray]:
    """Draws errors of the velocities (N, 6) from their covariances."""
    rng = np.random.default_rng(0)
    values, axes = np.linalg.eigh(np.where(known[:, None, None], np.nan_to_num(spread), 0.0))
    roots = axes * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    draws = rng.standard_normal((_DRAWS, len(known), 6))
    return [np.einsum("nij,nj->ni", roots, draw) for draw in draws]


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
    if len(pixels) < HELD_BY:
        return np.full(len(at), np.nan)
    away = np.linalg.norm(at[:, None] - pixels[None], axis=2)
    nearest = np.argsort(away, axis=1, kind="stable")[:, :HELD_BY]
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
    middle = float(np.median(distance[good]))
    # The centre moves in the world, and the camera turns: p <- exp(w) (p - R v).
    by_point = camera.project_jacobian(points, with_params=False)[0]
    by_shift = -by_point @ camera_from_world[:3, :3]
    matrix = np.concatenate([by_shift, differentiate_by_turn(by_point, points)], axis=2)
    kept = np.isfinite(matrix).all(axis=(1, 2))
    matrix, speed = matrix[kept], speed[kept]
    if len(matrix) < _FEWEST_CORNERS:
        return unknown
    # Shifts and turns of a size: the normal equations stay well scaled.
    size = np.array([1 / middle] * 3 + [1.0] * 3)
    weight = np.ones(len(matrix))
    for _ in range(ROUNDS):
        root = np.sqrt(weight)[:, None]
        left = (root[:, :, None] * matrix / size).reshape(-1, 6)
        found = np.linalg.lstsq(left, (root * speed).ravel(), rcond=None)[0] / size
        off = np.linalg.norm(speed - matrix @ found, axis=1)
        weight = 1 / (1 + (off / max(float(np.median(off)), 1e-9)) ** 2)
    variance = float(np.median(off)) ** 2 / (2 * math.log(2)) * len(matrix) / (len(matrix) - 3)
    normal = left.T @ left
    return found, variance * np.linalg.pinv(normal) / np.outer(size, size)
