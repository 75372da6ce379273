"""Joins images with points that others see, and fits focal lengths to what an image sees."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from gsut import _core
from gsut.lens import Camera, find_focal_params, with_scaled_focal
from gsut.sfm.lens.information import differentiate_by_turn
from gsut.sfm.matches import RawMatches
from gsut.sfm.photographs import Features, PosesOptions
from gsut.sfm.solution import MIN_INLIERS, Solution

# Factors on the focal length that an image without a pose is tried with.
_FACTORS = np.geomspace(0.25, 4.0, 33)
_TRIED_MATCHES = 200  # of an image that is tried with several focal lengths
_ROUGH = 3.0  # on the largest error of a trial, which may lie between two factors
_FEWEST_POINTS = 20  # of an image whose focal length is found
_ROUNDS = 8  # of Gauss-Newton
_KNOWN_SIGMA = 0.02  # largest standard deviation of the logarithm of an image's focal length


Sightings = tuple[np.ndarray, np.ndarray]  # pixels (M, 2) and the points (M, 3) seen there


def gather_sightings(
    solution: Solution, features: Sequence[Features], raw: RawMatches
) -> dict[int, Sightings]:
    """Returns, by image, the pixels and the points (M, 3) of others that its matches join."""
    return {
        image: (features[image].pixels[rows[:, 0]], solution.points[rows[:, 1]])
        for image, rows in join_points(solution, features, raw).items()
        if len(rows) >= _FEWEST_POINTS
    }


def join_points(
    solution: Solution, features: Sequence[Features], raw: RawMatches
) -> dict[int, np.ndarray]:
    """Returns, by image, (M, 2) its features and the points of others that its matches join."""
    point_of = index_points(solution, features)
    found: dict[int, list[np.ndarray]] = {}
    for pair, matches in zip(raw.pairs, raw.matches, strict=True):
        for own in (0, 1):
            image, other = int(pair[own]), int(pair[1 - own])
            if not solution.registered[other]:
                continue
            point = point_of[other][matches[:, 1 - own]]
            rows = np.stack([matches[:, own], point], axis=1)[point >= 0]
            found.setdefault(image, []).append(rows[:_TRIED_MATCHES])
    # One number for a feature and a point: rows of two are sorted far slower.
    count = max(1, len(solution.points))
    joined = {}
    for image, parts in found.items():
        feature, point = np.concatenate(parts).T
        joined[image] = np.stack(np.divmod(np.unique(feature * count + point), count), axis=1)
    return joined


def index_points(solution: Solution, features: Sequence[Features]) -> list[np.ndarray]:
    """Returns the point that each feature of each image observes, -1: none."""
    return solution.index_points(np.array([len(f) for f in features]))


def try_focals(
    lens: Camera, pixels: np.ndarray, points: np.ndarray, options: PosesOptions, least: float
) -> float:
    """Finds the logarithm of the factor on the focal length by which an image fits its matches.

    Returns:
        NaN if no factor fits at least this share of the matches.
    """
    max_error = _ROUGH * options.max_error * math.hypot(lens.width, lens.height) / 1000
    some = slice(None, None, max(1, len(pixels) // _TRIED_MATCHES))
    pixels, points = pixels[some], points[some]
    most, best = 0, None
    for factor in _FACTORS:
        scaled = with_scaled_focal(lens, factor)
        bearings = _core.ImageBearings(scaled, pixels)
        rows = np.flatnonzero(bearings.valid)
        pose, inliers = _core.absolute_pose(bearings, rows, points[rows], max_error, options.seed)
        if inliers.sum() > most:
            most, best = int(inliers.sum()), (factor, pose, rows[inliers])
    if best is None or most < max(MIN_INLIERS, least * len(pixels)):
        return math.nan
    factor, pose, rows = best
    return math.log(factor) + _fit_focal(
        with_scaled_focal(lens, factor), pose, pixels[rows], points[rows]
    )


def _fit_focal(lens: Camera, pose: np.ndarray, pixels: np.ndarray, points: np.ndarray) -> float:
    """Fits the pose and the logarithm of the factor on the focal length to an image.

    Gauss-Newton with the weights of Cauchy's loss.

    Returns:
        The logarithm; NaN if it is not determined.
    """
    change, log, focal = np.zeros(7), 0.0, find_focal_params(lens)
    for _ in range(_ROUNDS):
        pose, log = _core.exp_pose(change[:6]) @ pose, log + float(change[6])
        scaled = with_scaled_focal(lens, math.exp(log))
        p = points @ pose[:3, :3].T + pose[:3, 3]
        by_p, by_params = scaled.project_jacobian(p)
        by_focal = by_params[:, :, focal] @ scaled.params[focal]
        off = pixels - scaled.project(p)[0]
        matrix = np.concatenate(
            [by_p, differentiate_by_turn(by_p, p), by_focal[:, :, None]], axis=2
        )
        good = np.isfinite(matrix).all(axis=(1, 2)) & np.isfinite(off).all(axis=1)
        if good.sum() < _FEWEST_POINTS:
            return math.nan
        matrix, off = matrix[good], off[good]
        squared = np.sum(off**2, axis=1)
        scale = max(float(np.median(squared)), 1e-12)
        root = np.sqrt(1 / (1 + squared / scale))[:, None]
        left = (root[:, :, None] * matrix).reshape(-1, 7)
        size = np.linalg.norm(left, axis=0)
        if not (size > 0).all():
            return math.nan
        change = np.linalg.lstsq(left / size, (root * off).ravel(), rcond=None)[0] / size
        if not np.isfinite(change).all() or abs(change[6]) > 1:
            return math.nan
    inverse = np.linalg.pinv((left / size).T @ (left / size))
    sigma = math.sqrt(scale * inverse[6, 6]) / size[6]
    return log if sigma < _KNOWN_SIGMA else math.nan
