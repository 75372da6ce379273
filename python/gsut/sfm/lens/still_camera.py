"""Decides whether a camera moved, from matches alone, before its lens and poses are searched."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from gsut import _core
from gsut._core import SolveError
from gsut.judge import (
    Matches,
    Structure,
    measure_angular_errors,
    measure_pixels_per_radian,
    prefer,
)
from gsut.lens import Camera
from gsut.sfm.lens.candidates import explain_implausible, list_lens_ladder
from gsut.sfm.lens.ranking import MATCHES, QUICK_PAIRS, choose_informative_pairs
from gsut.sfm.mapping import Mapping

_TRIED = 3  # lenses, through which rotations explain most, that are adjusted
_TURN_ERROR = 3.0  # factor on the largest error where a lens is only nearly right
_MOSTLY = 0.6  # share of a pair's matches, below which no lens near makes a rotation of its motion
_EXPLAINED = 0.9  # share of what poses explain that rotations must, and of the pairs
_FEWEST_MATCHES = 20  # that agree with a pose, of a pair that counts
_ROUNDS = 5  # of reweighting, and of adjusting a lens: both settle in three or four
# Standard deviations of a lens about one of the ladder: logarithm of the focal length, principal
# point over the diagonal, two radial coefficients.
_LENS_SIGMAS = np.array([0.2, 0.02, 0.02, 0.1, 0.1])
_STEP = 1e-4  # of numerical derivatives


class _Sample(NamedTuple):
    """Matches of some pairs of images: (P, 2) images, rows of each pair, (2, M, 2) pixels."""

    images: np.ndarray
    pair: np.ndarray
    pixels: np.ndarray

    def take(self, pairs: int) -> _Sample:
        """Returns the matches of the first pairs."""
        kept = self.pair < pairs
        return _Sample(self.images[:pairs], self.pair[kept], self.pixels[:, kept])


class _Explained(NamedTuple):
    """Rays (2, M, 3) through lenses, errors (M,) of poses in pixels, and which matches agree."""

    rays: np.ndarray
    errors: np.ndarray
    agree: np.ndarray
    turned: int


def require_motion(mapping: Mapping) -> None:
    """Rejects images whose camera turned or stood still, so that they have no depth.

    Compares rotations of pairs of images with poses that have a translation, each through the lens
    that suits it best. Errors of a rotation are two-dimensional and count by their root mean
    square, as those of poses are distances from epipolar planes.

    Args:
        mapping: with features and raw matches. Several unknown lenses are not looked at.

    Raises:
        SolveError: rotations explain the matches as well as poses with translation; says of how
            many pairs, and what to do.
    """
    photographs, cameras = mapping.photographs, mapping.images.cameras
    sample = _choose_sample(mapping)
    if not len(sample.pair):
        return
    extent = math.hypot(cameras[0].width, cameras[0].height)
    limit = mapping.options.max_two_view_error * extent / 1000
    if mapping.found.figures["lens"] == "known":
        found = _explain_by_poses(sample, cameras, limit)
        turns = [_fit_turns(sample, found, cameras, limit)[0]]
        poses = [found.errors]
    elif len(photographs.unknown_groups[0].images) == len(photographs):
        turns, poses = _try_lenses(mapping, sample, limit)
    else:
        return
    if turns:
        by_turns = min(turns, key=lambda errors: _measure_cost(errors, limit))
        by_poses = min(poses, key=lambda errors: _measure_cost(errors, limit))
        _compare(sample, by_turns, by_poses, extent, limit)


def _try_lenses(
    mapping: Mapping, sample: _Sample, limit: float
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Returns the errors (M,) of rotations, and those of poses, through lenses near them."""
    first, count = mapping.images.cameras[0], len(mapping.photographs)
    ladder = list_lens_ladder(first.width, first.height, mapping.options.fov)
    ladder += [c for c in mapping.photographs.candidates if c.model == ladder[0].model]
    lenses = [[lens] * count for lens in ladder]
    few = sample.take(QUICK_PAIRS)
    looks = [_explain_by_poses(few, each, _TURN_ERROR * limit) for each in lenses]
    agree = np.array([np.count_nonzero(look.agree) for look in looks])
    shares = np.array([look.turned for look in looks]) / np.maximum(agree, 1)
    order = np.argsort(-shares, kind="stable")
    if shares[order[0]] < _MOSTLY:
        return [], []
    turns, poses = [], [_explain_by_poses(sample, lenses[int(np.argmax(agree))], limit).errors]
    for each in order[:_TRIED]:
        lens = _fit_lens(sample, lenses[each], limit)
        if explain_implausible(lens, mapping.features) is None:
            found = _explain_by_poses(sample, [lens] * count, limit)
            poses.append(found.errors)
            turns.append(_fit_turns(sample, found, [lens] * count, limit)[0])
    return turns, poses


def _compare(
    sample: _Sample, turns: np.ndarray, poses: np.ndarray, extent: float, limit: float
) -> None:
    """Raises SolveError if rotations explain matches as well as poses do.

    Args:
        turns, poses: errors (M,) in pixels.
        extent, limit: of the images, and the largest error of a right match, in pixels.
    """
    matches, count = Matches(sample.images[sample.pair], extent), len(sample.images)
    preference = prefer(Structure(turns), Structure(poses, free=2 * count), matches)
    agree = [np.bincount(sample.pair[each < limit], minlength=count) for each in (turns, poses)]
    seen = agree[1] >= _FEWEST_MATCHES
    explained, count = int(np.sum(seen & (agree[0] >= _EXPLAINED * agree[1]))), int(seen.sum())
    few = 2 * count < len(sample.images)
    if preference.gain > 0 or few or explained < _EXPLAINED * count:
        return
    pairs = f"{explained} of {count} pairs of images"
    pixels = f"to {float(np.median(turns[turns < limit])):.1f} px, so there is no depth"
    shift = np.linalg.norm(sample.pixels[1] - sample.pixels[0], axis=1)
    if float(np.median(shift)) < limit:
        raise SolveError(
            f"the camera did not move: {pairs} show the same view {pixels}; walk around what you "
            "film, or, if it turned before a still background, leave that out by masks "
            "(masks/NAME.png)"
        )
    raise SolveError(
        f"the camera turned but did not move: {pairs} are explained by a rotation alone {pixels}; "
        "walk sideways while you film, near things with texture, instead of turning on the spot "
        "(programs that stitch panoramas can use these images)"
    )


def _measure_cost(errors: np.ndarray, limit: float) -> float:
    """Returns a robust mean of errors, which are wrong matches beyond the limit."""
    return float(np.mean(np.minimum(np.nan_to_num(errors / limit, nan=np.inf), 1.0) ** 2))


def _choose_sample(mapping: Mapping) -> _Sample:
    """Chooses matches of pairs whose displacements differ most, spread over the images."""
    features, raw = mapping.features, mapping.raw
    chosen = choose_informative_pairs(features, raw)
    images = np.asarray(raw.pairs)[chosen].reshape(-1, 2)
    rows = [raw.matches[i][:MATCHES] for i in chosen]
    pair = np.repeat(np.arange(len(rows)), [len(each) for each in rows])
    pixels = np.zeros((2, len(pair), 2))
    for side in range(2):
        for i, each in enumerate(rows):
            pixels[side, pair == i] = features[images[i, side]].pixels[each[:, side]]
    return _Sample(images, pair, pixels)


def _find_rays(sample: _Sample, lenses: Sequence[Camera]) -> np.ndarray:
    """Returns the unit rays (2, M, 3) of matched pixels; NaN where there is none."""
    rays = np.full((*sample.pixels.shape[:2], 3), np.nan)
    for side in range(2):
        of_match = sample.images[sample.pair, side]
        for lens in dict.fromkeys(lenses):
            own = np.array([each == lens for each in lenses])[of_match]
            found, valid = lens.unproject(sample.pixels[side, own])
            found = np.where(np.asarray(valid)[:, None], found, np.nan)
            rays[side, own] = found / np.linalg.norm(found, axis=1, keepdims=True)
    return rays


def _explain_by_poses(sample: _Sample, lenses: Sequence[Camera], limit: float) -> _Explained:
    """Explains the matches of each pair by a relative pose with translation."""
    rays = _find_rays(sample, lenses)
    seen = np.isfinite(rays).all(axis=(0, 2))
    numbers = [np.flatnonzero(seen & (sample.pair == i)) for i in range(len(sample.images))]
    bearings, rows = [], []
    for (a, b), own in zip(sample.images, numbers, strict=True):
        bearings += [
            _core.ImageBearings(lenses[image], sample.pixels[side, own])
            for side, image in ((0, a), (1, b))
        ]
        rows.append(np.repeat(np.arange(len(own), dtype=np.int32)[:, None], 2, axis=1))
    ends = np.arange(2 * len(numbers)).reshape(-1, 2)
    found = _core.verify_pairs(bearings, ends, rows, limit, 0)
    errors, agree, turned = np.full(len(seen), np.nan), np.zeros(len(seen), bool), 0
    scale = measure_pixels_per_radian(lenses[0])
    for own, (inliers, pose, turns, *_) in zip(numbers, found, strict=True):
        if not inliers.any():
            continue
        agree[own], turned = inliers, turned + turns
        poses = np.tile(np.eye(4), (2, len(own), 1, 1))
        poses[1] = np.linalg.inv(pose)
        errors[own] = scale * measure_angular_errors(rays[:, own], poses)
    return _Explained(rays, errors, agree, turned)


def _fit_turns(
    sample: _Sample, found: _Explained, lenses: Sequence[Camera], limit: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Fits a rotation to the matches of each pair: errors (M,), residuals (M, 3) and weights."""
    scale = measure_pixels_per_radian(lenses[0])
    one, two = np.nan_to_num(found.rays)
    weights = found.agree.astype(np.float64)
    for _ in range(_ROUNDS):
        outer = np.einsum("m,mi,mj->mij", weights, two, one)
        sums = np.zeros((len(sample.images), 3, 3))
        np.add.at(sums, sample.pair, outer)
        u, _, vt = np.linalg.svd(sums)
        u[:, :, 2] *= np.linalg.det(u @ vt)[:, None]
        turned = np.einsum("mij,mj->mi", (u @ vt)[sample.pair], one)
        residuals = scale * np.cross(turned, two)
        errors = np.linalg.norm(residuals, axis=1) / 2  # of its two directions, and of both rays
        weights = 1 / (1 + (errors / limit) ** 2) ** 2
    errors[~np.isfinite(found.rays).all(axis=(0, 2))] = np.nan
    return errors, residuals, np.where(np.isfinite(errors), weights, 0.0)


def _fit_lens(sample: _Sample, lenses: Sequence[Camera], limit: float) -> Camera:
    """Adjusts a Kannala-Brandt lens so that rotations explain matches best."""
    start = lenses[0]
    diagonal = math.hypot(start.width, start.height)
    found = _explain_by_poses(sample, lenses, _TURN_ERROR * limit)

    def change(x: np.ndarray) -> Camera:
        params = np.array(start.params)
        params[:2] *= math.exp(x[0])
        params[2:4] += diagonal * x[1:3]
        params[4 : 1 + len(x)] += x[3:]
        return start.with_params(params)

    def measure(x: np.ndarray, error: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        own = [change(x)] * len(lenses)
        return _fit_turns(sample, found._replace(rays=_find_rays(sample, own)), own, error)

    x = np.zeros(len(_LENS_SIGMAS))
    for number in range(_ROUNDS):
        error = limit * (_TURN_ERROR if number < 2 else 1.0)
        _, base, weights = measure(x, error)
        steps = _STEP * np.eye(len(x))
        slopes = [(measure(x + step, error)[1] - base).ravel() / _STEP for step in steps]
        jacobian = np.stack(slopes, axis=1)
        weight = np.repeat(weights, 3)
        normal = jacobian.T @ (weight[:, None] * jacobian) + np.diag(limit**2 / _LENS_SIGMAS**2)
        pull = jacobian.T @ (weight * base.ravel()) + limit**2 * x / _LENS_SIGMAS**2
        x = x - np.linalg.solve(normal, pull)
        x = np.clip(x, -3 * _LENS_SIGMAS, 3 * _LENS_SIGMAS)
    return change(x)
