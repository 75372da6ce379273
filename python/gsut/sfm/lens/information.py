"""What observations say of what all images share: a lens, or a readout time.

Poses and points are free too, and eliminated from the normal equations. Equations of many images at
once are large. A window of images with poses and points of its own is an independent estimate:
windows together know a little less than all images at once, because a point that two windows see
counts as two.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from gsut import _core
from gsut.data.poses import find_centers
from gsut.sfm.matches import FEWEST_MATCHES
from gsut.sfm.solution import (
    LOSS_SCALE,
    LensFlag,
    LensFlags,
    Solution,
    StatedTurns,
    index_lenses,
    transform_to_cameras,
)

_MOST_IMAGES = 400  # at once; of more the information is added up over windows
_WINDOW = 150  # images, about
GROUPS = 8  # of successive images, taken to err independently
MEDIAN_SQUARE = 2 * math.log(2)  # of a normal vector's length in the plane, in variances


class WeightedObservations:
    """Derivatives of the observations by their points, weighted as Cauchy's loss does.

    Args:
        solution: poses and points.
        free: flags of the lenses' parameters, see `Adjustment`.
        used: (S,) bool, the observations that count; None: all.

    Attributes:
        rows: (O,) which observations have derivatives.
        image, point: (O,) of these.
        p: (O, 3) their points in the camera.
        by_p: (O, 2, 3) derivatives by those, not weighted.
        by_lens: (O, 2, F) derivatives by the free parameters of all lenses, not weighted.
        lenses, bases: the different lenses, and what turns their free parameters into all.
        squared, median: (O,) squared lengths of the residuals, and their median.
        weight: (O, 1, 1) roots of the weights.
    """

    def __init__(
        self,
        solution: Solution,
        free: LensFlags = None,
        used: np.ndarray | None = None,
    ) -> None:
        self._poses = poses = solution.camera_from_world
        self.lenses = lenses = index_lenses(solution.cameras, free)
        self.bases = bases = [None if f is None else spread_free_parameters(f) for f in lenses.free]
        point, image = solution.observations[:, 0], solution.observations[:, 1]
        p = transform_to_cameras(solution.points, solution.observations, poses)
        of_lens = np.array(lenses.of_image)[image]
        ends = np.cumsum([0 if basis is None else basis.shape[1] for basis in bases])
        by_p, by_lens = np.zeros((len(p), 2, 3)), np.zeros((len(p), 2, ends[-1]))
        for number, (camera, basis, end) in enumerate(
            zip(lenses.cameras, bases, ends, strict=True)
        ):
            own = of_lens == number
            chosen = False if basis is None else np.flatnonzero(basis.any(axis=1))
            by_p[own], by_params = camera.project_jacobian(p[own], chosen)
            if basis is not None:
                by_lens[own, :, end - basis.shape[1] : end] = by_params @ basis[chosen]
        good = np.isfinite(by_p).all(axis=(1, 2)) & np.isfinite(solution.residuals).all(axis=1)
        self.rows = rows = np.flatnonzero(good if used is None else good & used)
        self.image, self.point = image[rows], point[rows]
        self.p, self.by_p, self.by_lens = p[rows], by_p[rows], by_lens[rows]
        self.squared = np.sum(solution.residuals[rows] ** 2, axis=1)
        self.median = float(np.median(self.squared)) if len(rows) else 0.0
        scale = LOSS_SCALE * max(math.sqrt(self.median), 1e-12)
        self.weight = np.sqrt(1 / (1 + self.squared / scale**2))[:, None, None]

    def differentiate_poses(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Returns (R, 2, 6) and (R, 2, 3) weighted derivatives of some by poses and points."""
        weighted = self.weight[rows] * self.by_p[rows]
        by_point = weighted @ self._poses[self.image[rows], :3, :3]
        turned = differentiate_by_turn(weighted, self.p[rows])
        return np.concatenate([-by_point, turned], axis=2), by_point

    def find_information(
        self,
        by_shared: Callable[[np.ndarray], np.ndarray],
        prior: np.ndarray,
        times: np.ndarray | None = None,
        turns: StatedTurns | None = None,
        left_out: Sequence[int] | np.ndarray = (),
    ) -> tuple[np.ndarray, int]:
        """Finds the information on what all images share; poses and points are free too.

        Args:
            by_shared: returns the weighted derivatives (R, 2, F) of some observations.
            prior: (D,) what is known beforehand of an image's unknowns, as their normal equations.
            times: (O,) of the observations' lines: bodies have a velocity too; None: they do not.
            turns: of a gyroscope, whose standard deviations are in the features' noise: what is
                not known of its calibration is shared too, after the other unknowns.
            left_out: images whose observations do not count.

        Returns:
            The normal equations (F, F), and coordinates minus the directions that poses and points
            take up.
        """
        centers, known = find_centers(self._poses), np.unique(self.image)
        is_large = len(known) > _MOST_IMAGES
        total: np.ndarray | int = 0
        freedom = 2 * len(self.rows)
        windows = split_windows(self.image, self.point, len(centers)) if is_large else [known]
        for window in (np.setdiff1d(images, left_out) for images in windows):
            if not len(window):
                continue
            chosen = np.flatnonzero(np.isin(self.image, window))
            by_pose, by_point = self.differentiate_poses(chosen)
            if times is not None:
                moved = times[chosen, None, None] * by_pose
                by_pose = np.concatenate([by_pose, moved], axis=2)
            rows = (
                np.searchsorted(window, self.image[chosen]),
                np.unique(self.point[chosen], return_inverse=True)[1],
                by_pose, by_shared(chosen), by_point,
            )  # fmt: skip
            gauge = _hold_gauge(centers[window], prior)
            if turns is not None:
                rows = _append_turns(
                    rows, turns.select(window), len(turns.calibration_sigma), gauge
                )
            own, determined = _core.shared_information(*rows, prior, gauge)
            total = total + own
            freedom -= determined
        return np.asarray(total), freedom

    def estimate_spread(self, freedom: int) -> float:
        """Estimates the factor of the inverse normal equations that makes them a covariance.

        Takes in what Cauchy's loss costs (Huber 1964: E[psi^2] / E[psi']^2).

        Args:
            freedom: number of coordinates minus unknowns.
        """
        weight, lost = self.weight[:, 0, 0] ** 2, 2 * len(self.squared) / freedom
        psi = float(np.mean(weight**2 * self.squared)) / 2
        return lost * psi / float(np.mean(weight)) / self.curvature**2

    @property
    def curvature(self) -> float:
        """Returns the curvature of Cauchy's loss over that of the weighted squares."""
        weight = self.weight[:, 0, 0] ** 2
        # psi = w r; over all directions of a residual r in the plane its mean derivative is w^2.
        return float(np.mean(weight**2)) / float(np.mean(weight))


Rows = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def _append_turns(rows: Rows, turns: StatedTurns | None, unknowns: int, gauge: list[int]) -> Rows:
    """Appends turns to observations, with the calibration's unknowns as columns of `by_shared`.

    A turn is a point that both images see, each by half of the residual, as in the adjustment.

    Args:
        rows: images, points, and derivatives by pose, shared unknowns and point.
        turns: between the same images.
        unknowns: of the calibration.
        gauge: unknowns of images that stay.
    """
    image, point, by_pose, by_shared, by_point = rows
    shared = by_shared.shape[2]
    by_shared = np.concatenate([by_shared, np.zeros((len(image), 2, unknowns))], axis=2)
    if turns is None:
        return image, point, by_pose, by_shared, by_point
    pairs, size = len(turns.images), by_pose.shape[2]
    half = math.sqrt(2) / turns.sigma
    # Of the first image, then of the second one: three components, and an empty fourth.
    of_pose, of_shared, of_point = (
        np.zeros((2, pairs, 4, width)) for width in (size, shared + unknowns, 3)
    )
    of_pose[0, :, :3, 3:6], of_pose[1, :, :3, 3:6] = -half * turns.rotations, half * np.eye(3)
    of_shared[0, :, :3, shared:] = -half * turns.by_calibration
    of_point[0, :, :3], of_point[1, :, :3] = -half * np.eye(3), half * np.eye(3)
    for end in range(2):
        columns = size * turns.images[:, end, None] + np.arange(size)
        of_pose[end] *= ~np.isin(columns, gauge)[:, None, :]
    first = int(point.max(initial=-1)) + 1
    return (
        np.concatenate([image, turns.images.T.repeat(2)]),
        np.concatenate([point, np.tile(np.repeat(first + np.arange(pairs), 2), 2)]),
        np.concatenate([by_pose, of_pose.reshape(-1, 2, size)]),
        np.concatenate([by_shared, of_shared.reshape(-1, 2, shared + unknowns)]),
        np.concatenate([by_point, of_point.reshape(-1, 2, 3)]),
    )


def invert_scaled(normal: np.ndarray) -> np.ndarray:
    """Inverts normal equations, scaled; NaN where they are singular."""
    size = 1 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
    try:
        return np.linalg.inv(normal * np.outer(size, size)) * np.outer(size, size)
    except np.linalg.LinAlgError:
        return np.full_like(normal, np.nan)


def spread_free_parameters(flags: np.ndarray) -> np.ndarray:
    """Returns (K, F) with a column for each free parameter or tied group of the flags (K,).

    A parameter that is near tied ones is in their column and has its own.
    """
    flags = np.asarray(flags).astype(int)
    groups = np.where(flags == LensFlag.FREE, -1 - np.arange(len(flags)), flags)
    wanted = list(dict.fromkeys(groups[flags > 0].tolist()))
    columns = np.stack([groups == group for group in wanted], axis=1).astype(np.float64)
    near = np.ix_(groups == LensFlag.NEAR, np.array(wanted) == LensFlag.TIED)
    columns[near] = 1.0
    return columns


def differentiate_by_turn(by_point: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Returns (N, 2, 3) the derivative by w of a function of p + w x p.

    Args:
        by_point: (N, 2, 3) its derivative by the point.
        p: (N, 3) the points.
    """
    return np.cross(p[:, None, :], by_point)


def split_windows(image: np.ndarray, point: np.ndarray, images: int) -> list[np.ndarray]:
    """Splits images into windows that share many points.

    A window grows by the image that sees most of its points, and the next one begins beside it.

    Args:
        image, point: (S,) of the observations.
        images: number of images; those without observations are in no window.

    Returns:
        The sorted images of each window.
    """
    by_image, by_point = np.argsort(image, kind="stable"), np.argsort(point, kind="stable")
    begin_image = np.searchsorted(image[by_image], np.arange(images + 1))
    begin_point = np.searchsorted(point[by_point], np.arange(int(point.max(initial=-1)) + 2))
    is_open = np.diff(begin_image) > 0
    count = max(1, round(int(is_open.sum()) / _WINDOW))
    size = -(-int(is_open.sum()) // count)
    windows: list[np.ndarray] = []
    shared = np.zeros(images, np.int64)
    while is_open.any():
        own: list[int] = []
        following = int(np.argmax(np.where(is_open, shared, -1)))
        shared = np.zeros(images, np.int64)
        is_known = np.zeros(len(begin_point) - 1, bool)
        while len(own) < size and is_open[following]:
            own.append(following)
            is_open[following] = False
            seen = point[by_image[begin_image[following] : begin_image[following + 1]]]
            seen = np.unique(seen[~is_known[seen]])
            is_known[seen] = True
            lengths = begin_point[seen + 1] - begin_point[seen]
            steps = np.arange(lengths.sum()) - np.repeat(np.cumsum(lengths) - lengths, lengths)
            rows = by_point[np.repeat(begin_point[seen], lengths) + steps]
            shared += np.bincount(image[rows], minlength=images)
            following = int(np.argmax(np.where(is_open, shared, -1)))
            if shared[following] < FEWEST_MATCHES:
                break
        windows.append(np.sort(own))
    return windows


def _hold_gauge(centers: np.ndarray, prior: np.ndarray) -> list[int]:
    """Lists the unknowns of images (N, 3) that fix the gauge, on which nothing depends.

    The first image's pose, and one component of the farthest centre.
    """
    away = centers - centers[0]
    second = int(np.argmax((away**2).sum(axis=1)))
    axis = int(np.argmax(np.abs(away[second])))
    return [*range(6), len(prior) * second + axis]
