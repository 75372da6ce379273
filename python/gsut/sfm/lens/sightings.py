"""Finds images of several zooms that were taken for those of one lens, by their focal lengths."""

from __future__ import annotations

import contextlib
import functools
import math
from collections.abc import Sequence

import numpy as np

from gsut import _core
from gsut._core import SolveError
from gsut.data import list_some
from gsut.lens import Camera, find_focal_params, has_focal_length, with_scaled_focal
from gsut.sfm.lens.candidates import make_lens
from gsut.sfm.lens.information import differentiate_by_turn
from gsut.sfm.lens.search import search_lens
from gsut.sfm.lens.trials import run_trials
from gsut.sfm.mapping import Mapping, Zoom
from gsut.sfm.matches import RawMatches, select_pairs
from gsut.sfm.photographs import Features, PosesOptions
from gsut.sfm.solution import MIN_INLIERS, OnStep, Solution

# Factors on the focal length that an image without a pose is tried with.
_FACTORS = np.geomspace(0.25, 4.0, 33)
_TRIED_MATCHES = 200  # of an image that is tried with several focal lengths
_MOST_TRIED = 40  # images that are tried: enough to see a second zoom
_FITS = 0.5  # share of the usual share of matches that must fit for a trial to count
_ROUGH = 3.0  # on the largest error of a trial, which may lie between two factors
_FITTED_POINTS = 300  # of an image, by which its focal length is found at most
_FEWEST_POINTS = 20  # of an image whose focal length is found
_ROUNDS = 8  # of Gauss-Newton
_DOUBTED = 0.7  # share of the usual share of fitting matches below which a pose is doubted
_KNOWN_SIGMA = 0.02  # largest standard deviation of the logarithm of an image's focal length
_ZOOM_GAP = 0.05  # of the logarithms of neighbouring focal lengths between two zooms
_FEWEST_IMAGES = 3  # of a zoom
_MOST_OF_ALL = 0.9  # share of the images that zooms must hold together, or there are none
_LEFT_OUT = 0.1  # share of the images without a pose from which they may be of another zoom
_LINKED_MATCHES = 50  # of a pair that is compared at several focal lengths
_PAIRS_OF_AN_IMAGE = 5  # that are compared at several focal lengths
_COMPARED_MATCHES = 100  # of such a pair
_FOCALS = np.geomspace(0.45, 2.2, 15)  # factors on the focal length that pairs are compared at
_FIELD = 60.0  # degrees across of the lens whose focal length is scaled where none was found


Sightings = tuple[np.ndarray, np.ndarray]  # pixels (M, 2) and the points (M, 3) seen there


def search_zooms(mapping: Mapping) -> Mapping:
    """Searches the lens, and the zooms of the images where they are several.

    Images of two zooms can pass for images of one between them, from nearer and from farther away.
    Where a tenth of the images are left without a pose, and the matches of some suggest another
    zoom than those of most, the lens is searched once more by the latter alone.

    Returns:
        The run with what `search_lens` finds, and the zooms.

    Raises:
        SolveError: see `search_lens`.
    """
    features, raw, options = mapping.features, mapping.raw, mapping.options
    failure, first = None, mapping
    try:
        first = search_lens(mapping)
    except SolveError as error:
        failure = error
    solution = first.solution
    if solution is not None:
        first = first.add_findings(zooms=find_zooms(solution, features, raw, options))
        if first.found.zooms or solution.num_registered >= (1 - _LEFT_OUT) * len(features):
            return first
    size = mapping.photographs.lenses[0]
    start = make_lens(size.width, size.height, _FIELD, 1.0)
    lens = start if solution is None else solution.cameras[0]
    group, others = _split_by_zoom(lens, features, raw, options)
    if len(others) >= _FEWEST_IMAGES and len(group) > _FEWEST_IMAGES:
        own = select_pairs(raw, {(int(a), int(b)) for a, b in raw.pairs if {a, b} <= group})
        with contextlib.suppress(SolveError):
            again = search_lens(mapping.replace(raw=own)).replace(raw=raw)
            again = again.add_findings(zooms=find_zooms(again.solved, features, raw, options))
            if again.found.zooms:
                return again
    if failure is not None:
        raise failure
    return first


def _split_by_zoom(
    lens: Camera, features: Sequence[Features], raw: RawMatches, options: PosesOptions
) -> tuple[set[int], set[int]]:
    """Splits images into those probably of the zoom of most, and those of another.

    Matches of a pair agree through a lens of the right focal length if both images have that one,
    and hardly more with one than with another if they have two: each image gets the focal length
    that its pairs favour most. Images without enough matches are in neither.
    """
    used = np.zeros(len(features), np.int64)
    chosen = []
    for index in np.argsort([-len(matches) for matches in raw.matches], kind="stable"):
        pair = raw.pairs[index]
        if len(raw.matches[index]) >= _LINKED_MATCHES and used[pair].min() < _PAIRS_OF_AN_IMAGE:
            used[pair] += 1
            chosen.append(index)
    pairs, matches = raw.pairs[chosen], [raw.matches[i][:_COMPARED_MATCHES] for i in chosen]
    max_error = options.max_two_view_error * math.hypot(lens.width, lens.height) / 1000
    agree = np.zeros((len(_FOCALS), len(chosen)))
    for row, factor in zip(agree, _FOCALS, strict=True):
        scaled = with_scaled_focal(lens, factor)
        bearings = [_core.ImageBearings(scaled, f.pixels) for f in features]
        seen = [
            m[bearings[a].valid[m[:, 0]] & bearings[b].valid[m[:, 1]]]
            for (a, b), m in zip(pairs, matches, strict=True)
        ]
        found = _core.verify_pairs(bearings, pairs, seen, max_error, options.seed)
        row[:] = [each[0].sum() / len(m) for each, m in zip(found, matches, strict=True)]
    more = agree - np.median(agree, axis=0)
    of_image = np.zeros((len(features), len(_FOCALS)))
    for end in pairs.T:
        np.add.at(of_image, end, more.T)
    near = np.abs(of_image.argmax(axis=1) - more.sum(axis=1).argmax()) <= 1
    most, others = (np.flatnonzero(which & (used > 0)) for which in (near, ~near))
    return set(most.tolist()), set(others.tolist())


def find_zooms(
    solution: Solution, features: Sequence[Features], raw: RawMatches, options: PosesOptions
) -> list[Zoom]:
    """Finds the zooms that the images were taken at, most images first; [] if it was one.

    Each image's focal length is found with its pose while the points stay: those with a pose by
    their observations; the others, and those whose pose fits fewer of their matches than is usual,
    by their matches with the points, which a ladder of focal lengths is tried on.

    Args:
        solution: with one lens for all images.
        features: of all images.
        raw: their matches, which hold across zooms; verified ones do not.
    """
    lens = solution.cameras[0]
    if len(set(solution.cameras)) > 1 or solution.shutter is not None or not has_focal_length(lens):
        return []
    logs = np.full(len(features), np.nan)
    sightings = gather_sightings(solution, features, raw)
    shares = _measure_fitting_shares(solution, sightings, options)
    if np.isnan(shares).all():
        return []
    usual = float(np.nanmedian(shares))
    doubted = shares < _DOUBTED * usual
    for image in np.flatnonzero(solution.registered & ~doubted):
        rows = np.flatnonzero(solution.observations[:, 1] == image)
        rows = rows[:: max(1, len(rows) // _FITTED_POINTS)]
        points = solution.points[solution.observations[rows, 0]]
        pose = solution.camera_from_world[image]
        logs[image] = _fit_focal(lens, pose, solution.pixels[rows], points)
    tried = [n for n in sorted(sightings) if doubted[n] or not solution.registered[n]]
    tried = tried[:: max(1, -(-len(tried) // _MOST_TRIED))]

    def try_image(number: int, _: OnStep) -> float:
        return try_focals(lens, *sightings[number], options, _FITS * usual)

    if tried:
        logs[tried] = run_trials([functools.partial(try_image, number) for number in tried])
    return [
        Zoom(
            float(lens.params[find_focal_params(lens)[0]] * math.exp(np.median(logs[group]))),
            [solution.names[image] for image in group],
        )
        for group in _group_by_focal(logs)
    ]


def describe_zooms(zooms: Sequence[Zoom]) -> list[str]:
    """Describes several zooms and what to do, in a sentence; [] where there are not several."""
    if not zooms:
        return []
    others = [name for zoom in zooms[1:] for name in zoom.names]
    counts = ", ".join(f"{len(z.names)} at a focal length of {z.focal:.0f} px" for z in zooms)
    return [
        f"the images were taken at {len(zooms)} zooms: {counts}. One lens cannot serve them all: "
        f"put {list_some(others)} into a folder of their own, or give lens files in a dataset"
    ]


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


def _measure_fitting_shares(
    solution: Solution, sightings: dict[int, Sightings], options: PosesOptions
) -> np.ndarray:
    """Returns (N,) the share of the matches with points that an image's pose fits, or NaN."""
    lens = solution.cameras[0]
    max_error = options.max_error * math.hypot(lens.width, lens.height) / 1000
    shares = np.full(len(solution.names), np.nan)
    for image, (pixels, points) in sightings.items():
        if solution.registered[image]:
            pose = solution.camera_from_world[image]
            seen, _ = lens.project(points @ pose[:3, :3].T + pose[:3, 3])
            shares[image] = float(np.mean(np.linalg.norm(seen - pixels, axis=1) < max_error))
    return shares


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


def _group_by_focal(logs: np.ndarray) -> list[np.ndarray]:
    """Groups images by focal length, largest group first; [] where there are not several."""
    known = np.flatnonzero(np.isfinite(logs))
    order = known[np.argsort(logs[known], kind="stable")]
    cuts = np.flatnonzero(np.diff(logs[order]) > _ZOOM_GAP) + 1
    groups = [group for group in np.split(order, cuts) if len(group) >= _FEWEST_IMAGES]
    if len(groups) < 2 or sum(map(len, groups)) < _MOST_OF_ALL * len(known):
        return []
    return [np.sort(group) for group in sorted(groups, key=len, reverse=True)]
