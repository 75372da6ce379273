"""Decides whether a camera moved, from matches alone, before its lens and poses are searched."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from gsut import _core
from gsut._core import SolveError
from gsut.gaussians import find_nearest_rotation
from gsut.judge import (
    LEAST_NOISE,
    SURE,
    estimate_share,
    measure_angular_errors,
    measure_pixels_per_radian,
)
from gsut.least_squares import ROUNDS
from gsut.lens import Camera
from gsut.sfm.lens.candidates import list_lens_ladder
from gsut.sfm.lens.ranking import (
    PAIRS,
    ROUGH,
    choose_informative_pairs,
)
from gsut.sfm.mapping import Mapping
from gsut.sfm.matches import ALL_SAME, ENOUGH_MATCHES, FEWEST_MATCHES
from gsut.sfm.photographs import MOST_TRIED

_MOSTLY = 0.35  # share of a pair's matches, below which no lens near makes a rotation of its motion
# Share of what poses explain that rotations must: where the camera moved, at most a third.
_EXPLAINED = 0.75
# Diagonal over focal length of lenses through which a turn looks like a move along a plane.
_LEAST_FIELD = 0.6
# The same of a known lens, through which rotations of a straight flight over a plane are clearly
# less exact in the upper quartile of its pairs: 4 to 7 times, in turns mostly below 3.
_LEAST_KNOWN_FIELD = 1.4
_LESS_EXACT = 3.0
# Standard deviations of a lens about one of the ladder: logarithm of the focal length, principal
# point over the diagonal, two radial coefficients.
_LENS_SIGMAS = np.array([0.2, 0.02, 0.02, 0.1, 0.1])
_STEP = 1e-4  # of numerical derivatives


class _Sample(NamedTuple):
    """Matches of some pairs of images: (P, 2) images, rows of each pair, (2, M, 2) pixels.

    Every second match is fitted, and the others judge what was found.
    """

    images: np.ndarray
    pair: np.ndarray
    pixels: np.ndarray
    fitted: np.ndarray


class _Explained(NamedTuple):
    """Rays (2, M, 3) through lenses, errors (M,) of poses in pixels, and which matches agree.

    The parallax (M,) is how far a match lies from where points at infinity do, in pixels.
    """

    rays: np.ndarray
    errors: np.ndarray
    agree: np.ndarray
    turned: int
    parallax: np.ndarray


def require_motion(mapping: Mapping) -> None:
    """Rejects images whose camera turned or stood still, so that they have no depth.

    Compares rotations of pairs of images with poses that have a translation, each through the lens
    that suits it best: fitted to every second match, they are judged by the others. A rotation says
    where in a picture a match lies; a pose leaves its place along a line open.

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
        turns, poses = [_fit_turns(sample, found, cameras, limit)[0]], [found]
        is_narrow = any(_measure_field(lens) < _LEAST_KNOWN_FIELD for lens in cameras)
        if is_narrow and _compare_exactness(sample, turns[0], found.errors) > _LESS_EXACT:
            return
    elif len(photographs.unknown_groups[0].images) == len(photographs):
        turns, poses = _try_lenses(mapping, sample, limit)
    else:
        return
    if turns:
        rows = [_score_matches(errors, None, sample.fitted, extent) for errors in turns]
        by_turns = int(np.argmax([score[sample.fitted].sum() for score in rows]))
        others = [_score_matches(f.errors, f.parallax, sample.fitted, extent) for f in poses]
        by_poses = int(np.argmax([score[sample.fitted].sum() for score in others]))
        gain = float((others[by_poses] - rows[by_turns])[~sample.fitted].sum())
        if gain <= 0:
            _refuse_turns(sample, turns[by_turns], poses[by_poses].errors, limit)


def _measure_field(lens: Camera) -> float:
    """Returns a lens's diagonal in focal lengths."""
    return math.hypot(lens.width, lens.height) / measure_pixels_per_radian(lens)


def _compare_exactness(sample: _Sample, turns: np.ndarray, poses: np.ndarray) -> float:
    """Returns how much less exact rotations are than poses in the upper quartile of the pairs."""
    held = ~sample.fitted & np.isfinite(turns) & np.isfinite(poses)
    rows = [held & (sample.pair == i) for i in range(len(sample.images))]
    ratios = [_find_median(turns[own]) / max(_find_median(poses[own]), LEAST_NOISE) for own in rows]
    return float(np.quantile(ratios, 0.75))


def _try_lenses(
    mapping: Mapping, sample: _Sample, limit: float
) -> tuple[list[np.ndarray], list[_Explained]]:
    """Returns the errors (M,) of rotations, and poses, through lenses near them."""
    first, count = mapping.images.cameras[0], len(mapping.photographs)
    ladder = list_lens_ladder(first.width, first.height, mapping.options.fov)
    ladder += [c for c in mapping.photographs.candidates if c.model == ladder[0].model]
    lenses = [[lens] * count for lens in ladder]
    looks = [_explain_by_poses(sample, each, ROUGH * limit) for each in lenses]
    agree = np.array([np.count_nonzero(look.agree) for look in looks])
    shares = np.array([look.turned for look in looks]) / np.maximum(agree, 1)
    order = np.argsort(-shares, kind="stable")
    if shares[order[0]] < _MOSTLY:
        return [], []
    turns, poses = [], [_explain_by_poses(sample, lenses[int(np.argmax(agree))], limit)]
    for each in order[:MOST_TRIED]:
        lens = _fit_lens(sample, lenses[each], limit)
        if _measure_field(lens) >= _LEAST_FIELD:
            poses.append(_explain_by_poses(sample, [lens] * count, limit))
            turns.append(_fit_turns(sample, poses[-1], [lens] * count, limit)[0])
    return turns, poses


def _refuse_turns(sample: _Sample, turns: np.ndarray, poses: np.ndarray, limit: float) -> None:
    """Raises SolveError if rotations explain nearly as many matches as poses do, of most pairs.

    Args:
        turns, poses: errors (M,) in pixels, of which those of every second match count.
        limit: the largest error of a right match, in pixels.
    """
    total, held = len(sample.images), ~sample.fitted
    agree = [np.bincount(sample.pair[held & (e < limit)], minlength=total) for e in (turns, poses)]
    seen = np.maximum(*agree) >= FEWEST_MATCHES // 2  # as half of all are fitted
    explained, count = int(np.sum(seen & (agree[0] >= _EXPLAINED * agree[1]))), int(seen.sum())
    if 2 * count < total or explained < _EXPLAINED * count:
        return
    pairs = f"{explained} of {count} pairs of images"
    pixels = f"to {float(np.median(turns[turns < limit])):.1f} px, so there is no depth"
    shift = np.linalg.norm(sample.pixels[1] - sample.pixels[0], axis=1)
    if not shift.any():
        raise SolveError(ALL_SAME)
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


def _score_matches(
    errors: np.ndarray, parallax: np.ndarray | None, fitted: np.ndarray, extent: float
) -> np.ndarray:
    """Returns the log-likelihood of matches (M,), over that of wrong matches, in nats.

    Args:
        errors: (M,) in pixels; of rotations, root mean squares of two directions; of poses with
            translation, from epipolar planes.
        parallax: (M,) of poses, from where points at infinity would be, in pixels; None: rotations.
        fitted: (M,) which the noise is estimated from.
        extent: pixels over which wrong matches spread.
    """
    known = fitted & np.isfinite(errors)
    noise = max(_find_median(errors[fitted]), LEAST_NOISE)
    reach = SURE * noise  # below it parallax shows no depth
    if parallax is not None:
        reach = max(_find_median(parallax[fitted]), reach)

    def evaluate(rows: np.ndarray) -> np.ndarray:
        off = (errors[rows] / noise) ** 2
        if parallax is None:
            return np.exp(-off) / (2 * np.pi * noise**2)
        across = np.exp(-0.5 * off) / (math.sqrt(2 * np.pi) * noise)
        return across * np.exp(-parallax[rows] / reach) / reach

    def update(weights: np.ndarray) -> None:
        nonlocal noise, reach
        noise = max(math.sqrt(weights @ errors[known] ** 2), LEAST_NOISE)
        if parallax is not None:
            reach = max(float(weights @ parallax[known]), SURE * noise)

    share = estimate_share(lambda: evaluate(known), update, int(fitted.sum()), extent**2)
    right = np.nan_to_num(evaluate(np.ones(len(errors), bool)))
    return np.log(1 - share + share * right * extent**2)


def _find_median(values: np.ndarray) -> float:
    """Returns the median of finite values; 0 without any."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else 0.0


def _choose_sample(mapping: Mapping) -> _Sample:
    """Chooses matches of pairs whose displacements differ most, spread over the images."""
    features, raw = mapping.features, mapping.raw
    chosen = choose_informative_pairs(features, raw)
    if not len(chosen):  # nothing moves at all
        chosen = np.argsort([-len(each) for each in raw.matches], kind="stable")[:PAIRS]
    images = np.asarray(raw.pairs)[chosen].reshape(-1, 2)
    rows = [raw.matches[i][:ENOUGH_MATCHES] for i in chosen]
    pair = np.repeat(np.arange(len(rows)), [len(each) for each in rows])
    pixels = np.zeros((2, len(pair), 2))
    for side in range(2):
        for i, each in enumerate(rows):
            pixels[side, pair == i] = features[images[i, side]].pixels[each[:, side]]
    number = np.concatenate([np.arange(len(each)) for each in rows] or [np.zeros(0, int)])
    return _Sample(images, pair, pixels, number % 2 == 0)


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
    fitted = seen & sample.fitted
    numbers = [np.flatnonzero(fitted & (sample.pair == i)) for i in range(len(sample.images))]
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
    parallax = errors.copy()
    scale = measure_pixels_per_radian(lenses[0])
    for i, (inliers, pose, turns, *_) in enumerate(found):
        if not inliers.any():
            continue
        agree[numbers[i]], turned = inliers, turned + turns
        own = np.flatnonzero(seen & (sample.pair == i))
        poses = np.tile(np.eye(4), (2, len(own), 1, 1))
        poses[1] = np.linalg.inv(pose)
        errors[own] = scale * measure_angular_errors(rays[:, own], poses)
        ahead = rays[0, own] @ pose[:3, :3].T
        apart = np.linalg.norm(np.cross(ahead, rays[1, own]), axis=1)
        parallax[own] = scale * apart / math.sqrt(2)  # of both rays, as errors are
    return _Explained(rays, errors, agree, turned, parallax)


def _fit_turns(
    sample: _Sample, found: _Explained, lenses: Sequence[Camera], limit: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Fits a rotation to the matches of each pair: errors (M,), residuals (M, 3) and weights."""
    scale = measure_pixels_per_radian(lenses[0])
    one, two = np.nan_to_num(found.rays)
    weights = found.agree.astype(np.float64)
    for _ in range(ROUNDS):
        outer = np.einsum("m,mi,mj->mij", weights, two, one)
        sums = np.zeros((len(sample.images), 3, 3))
        np.add.at(sums, sample.pair, outer)
        turned = np.einsum("mij,mj->mi", find_nearest_rotation(sums)[sample.pair], one)
        residuals = scale * np.cross(turned, two)
        errors = np.linalg.norm(residuals, axis=1) / 2  # of its two directions, and of both rays
        weights = sample.fitted / (1 + (errors / limit) ** 2) ** 2
    errors[~np.isfinite(found.rays).all(axis=(0, 2))] = np.nan
    return errors, residuals, np.where(np.isfinite(errors), weights, 0.0)


def _fit_lens(sample: _Sample, lenses: Sequence[Camera], limit: float) -> Camera:
    """Adjusts a Kannala-Brandt lens so that rotations explain matches best."""
    start = lenses[0]
    diagonal = math.hypot(start.width, start.height)
    found = _explain_by_poses(sample, lenses, ROUGH * limit)

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
    for number in range(ROUNDS):
        error = limit * (ROUGH if number < 2 else 1.0)
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
