"""Reconstructs the images that a solution left out, as part of it or as models of their own."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np

from gsut._core import SolveError
from gsut.sfm.matches import PairMatches
from gsut.sfm.photographs import Features, Images, PosesOptions
from gsut.sfm.solution.result import Solution, similarity_from_points
from gsut.sfm.solution.solver import adjust_registered, solve_poses

_FEWEST_IMAGES = 4  # of a model: fewer are hardly worth a training
_MOST_MODELS = 20  # beyond the first: more are fragments
_JOINING_POINTS = 30  # that must agree for two models to be merged: chance does not reach it
_SAMPLES = 200  # of three points that a similarity is fitted to
# Distance at which points of two models agree, over the median distance from their middle.
_AGREEING_DISTANCE = 0.03


def find_further_models(
    solution: Solution,
    features: Sequence[Features],
    pairs: Sequence[PairMatches],
    options: PosesOptions,
) -> tuple[Solution, list[Solution]]:
    """Reconstructs the images that a solution left out.

    A model whose points are seen in images of the first one too is merged with it.

    Args:
        features: of all images.
        pairs: verified matches.

    Returns:
        The largest model, and the others, largest first; each has an entry for every image.
    """
    found: list[Solution] = []
    left = ~solution.registered
    images = Images(solution.names, solution.cameras, features, solution.shutter, solution.lines)
    for model, _ in solve_left_out(images, left, pairs, options):
        merged = merge_models(solution, model, features, pairs, options)
        if merged is not None:
            solution = merged
        else:
            found.append(model)
    largest, *others = sorted([solution, *found], key=lambda model: -model.num_registered)
    return largest, others


def solve_left_out(
    images: Images, left: np.ndarray, pairs: Sequence[PairMatches], options: PosesOptions
) -> Iterator[tuple[Solution, list[PairMatches]]]:
    """Reconstructs the images that are left, one model after the other.

    Args:
        left: (N,) bool, the images without a pose; those of each model are taken out of it.
        pairs: verified matches.

    Yields:
        A model with an entry for every image, and the pairs that it was made from.
    """
    for _ in range(_MOST_MODELS):
        own = [pair for pair in pairs if left[pair.first] and left[pair.second]]
        if left.sum() < _FEWEST_IMAGES or not own:
            return
        try:
            model = solve_poses(images, own, options)
        except SolveError:
            return
        if model.num_registered < _FEWEST_IMAGES:
            return
        left &= ~model.registered
        yield model, own


def merge_models(
    first: Solution,
    second: Solution,
    features: Sequence[Features],
    pairs: Sequence[PairMatches],
    options: PosesOptions,
) -> Solution | None:
    """Merges two models of the same images in the world of the first.

    Returns:
        None if too few points join them, or where the images have a rolling shutter.
    """
    if first.shutter is not None:  # an adjustment would need the velocities of the images
        return None
    ours, theirs = _find_common_points(first, second, pairs)
    found = _fit_robust_similarity(theirs, ours, options.seed)
    if found is None:
        return None
    scale, rotation, translation = found
    poses = first.camera_from_world.copy()
    for image in np.flatnonzero(second.registered & ~first.registered):
        pose = second.camera_from_world[image]
        poses[image, :3, :3] = pose[:3, :3] @ rotation.T
        poses[image, :3, 3] = scale * pose[:3, 3] - poses[image, :3, :3] @ translation
    both = dataclasses.replace(
        first, camera_from_world=poses, registered=first.registered | second.registered
    )
    try:
        model = adjust_registered(both, features, pairs, options)
    except SolveError:
        return None
    if model.num_registered <= max(first.num_registered, second.num_registered):
        return None
    return model


def _find_common_points(
    first: Solution, second: Solution, pairs: Sequence[PairMatches]
) -> tuple[np.ndarray, np.ndarray]:
    """Returns (M, 3) points of the first and of the second model that matches join."""
    of_first, of_second = (
        {(int(image), int(feature)): int(point) for point, image, feature in s.observations}
        for s in (first, second)
    )
    joined: dict[tuple[int, int], None] = {}
    for pair in pairs:
        for a, b in pair.matches:
            ends = (pair.first, int(a)), (pair.second, int(b))
            for one, other in (ends, ends[::-1]):
                if one in of_first and other in of_second:
                    joined[of_first[one], of_second[other]] = None
    rows = np.array(list(joined), np.int64).reshape(-1, 2)
    return first.points[rows[:, 0]], second.points[rows[:, 1]]


def _fit_robust_similarity(
    source: np.ndarray, target: np.ndarray, seed: int
) -> tuple[float, np.ndarray, np.ndarray] | None:
    """Fits the similarity that most points agree with; None if too few do."""
    if len(source) < _JOINING_POINTS:
        return None
    rng = np.random.default_rng(seed)
    size = float(np.median(np.linalg.norm(target - np.median(target, axis=0), axis=1)))
    best = np.zeros(len(source), bool)
    for _ in range(_SAMPLES):
        rows = rng.choice(len(source), 3, replace=False)
        scale, rotation, translation = similarity_from_points(source[rows], target[rows])
        distances = np.linalg.norm(scale * source @ rotation.T + translation - target, axis=1)
        agree = distances < _AGREEING_DISTANCE * size
        if agree.sum() > best.sum():
            best = agree
    if best.sum() < _JOINING_POINTS:
        return None
    return similarity_from_points(source[best], target[best])
