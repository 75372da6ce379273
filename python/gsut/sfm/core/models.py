"""Views that do not connect: each group of them is a model of its own."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from gsut._core import SolveError
from gsut.sfm.core.alignment import similarity
from gsut.sfm.core.features import Features
from gsut.sfm.core.matching import PairMatches
from gsut.sfm.core.moving import Moving
from gsut.sfm.core.options import PosesOptions
from gsut.sfm.core.solution import Solution, refine, solve

_FEWEST = 4  # images of a model
_MOST = 20  # models
# Points of two models that must agree after a similarity, the samples of it, and how near they must
# come, of the median distance from the cameras.
_JOINING = 30
_SAMPLES = 200
_NEAR = 0.03


def further_models(
    solution: Solution,
    features: Sequence[Features],
    pairs: Sequence[PairMatches],
    options: PosesOptions,
) -> tuple[Solution, list[Solution]]:
    """Models of the images that a solution left out, largest first, and the solution.

    A model whose points are seen in images of the first too is merged with it.

    Args:
        solution: the first model. features: of all images.
        pairs: verified. options: see PosesOptions.

    Returns:
        The largest model, larger still if others were merged with it, and the others; each has one
        entry an image of all.
    """
    found: list[Solution] = []
    left = ~solution.registered
    while len(found) < _MOST and left.sum() >= _FEWEST:
        own = [pair for pair in pairs if left[pair.first] and left[pair.second]]
        if not own:
            break
        try:
            model = solve(
                solution.names, solution.cameras, features, own, options, lambda *_: None,
                shutter=solution.shutter,
            )  # fmt: skip
        except SolveError:
            break
        if model.num_registered < _FEWEST:
            break
        left &= ~model.registered
        merged = merge(solution, model, features, pairs, options)
        if merged is not None:
            solution = merged
        else:
            found.append(model)
    largest, *others = sorted([solution, *found], key=lambda model: -model.num_registered)
    return largest, others


def merge(
    first: Solution,
    second: Solution,
    features: Sequence[Features],
    pairs: Sequence[PairMatches],
    options: PosesOptions,
) -> Solution | None:
    """One model of two, in the world of the first; None if too few points join them.

    Args:
        first, second: of the same images, each with poses of some.
        others: see `further_models`.
    """
    if first.shutter is not None:
        return None  # `refine` knows no velocities
    ours, theirs = _common_points(first, second, pairs)
    found = _robust_similarity(theirs, ours, options.seed)
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
        model = refine_registered(both, features, pairs, options)
    except SolveError:
        return None
    if model.num_registered <= max(first.num_registered, second.num_registered):
        return None
    return model


def refine_registered(
    solution: Solution,
    features: Sequence[Features],
    pairs: Sequence[PairMatches],
    options: PosesOptions,
    *,
    only: Sequence[int] | None = None,
    lens_free: np.ndarray | None = None,
    moving: Moving | None = None,
    on_progress: Callable[[int, int, int, str], None] = lambda *_: None,
) -> Solution:
    """`refine` for the images that have a pose; the others stay without.

    Args:
        solution: poses to begin with. features, pairs: of all images.
        only: so few of those with a pose; None: all.
        others: see `refine`; `moving` has one rate an image of all.

    Raises:
        SolveError: too few points agree with the poses.
    """
    registered = np.flatnonzero(solution.registered) if only is None else only
    chosen = [int(image) for image in registered]
    place = {image: index for index, image in enumerate(chosen)}
    own = [
        dataclasses.replace(pair, first=place[pair.first], second=place[pair.second])
        for pair in pairs
        if pair.first in place and pair.second in place
    ]
    if moving is not None:
        moving = dataclasses.replace(moving, rates=moving.rates[chosen])
    model = refine(
        [solution.names[i] for i in chosen], [solution.cameras[i] for i in chosen],
        [features[i] for i in chosen], own, [solution.camera_from_world[i] for i in chosen],
        options, on_progress, lens_free=lens_free, moving=moving,
    )  # fmt: skip
    return _of_all(model, np.array(chosen), solution)


def _common_points(
    first: Solution, second: Solution, pairs: Sequence[PairMatches]
) -> tuple[np.ndarray, np.ndarray]:
    """(M, 3) points of the first and of the second model that matches between images join."""
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


def _robust_similarity(
    source: np.ndarray, target: np.ndarray, seed: int
) -> tuple[float, np.ndarray, np.ndarray] | None:
    """The similarity that most points agree with; None if too few do."""
    if len(source) < _JOINING:
        return None
    rng = np.random.default_rng(seed)
    near = _NEAR * float(np.median(np.linalg.norm(target - np.median(target, axis=0), axis=1)))
    best = np.zeros(len(source), bool)
    for _ in range(_SAMPLES):
        rows = rng.choice(len(source), 3, replace=False)
        agree = _off(similarity(source[rows], target[rows]), source, target) < near
        if agree.sum() > best.sum():
            best = agree
    if best.sum() < _JOINING:
        return None
    return similarity(source[best], target[best])


def _off(
    found: tuple[float, np.ndarray, np.ndarray], source: np.ndarray, target: np.ndarray
) -> np.ndarray:
    scale, rotation, translation = found
    return np.linalg.norm(scale * source @ rotation.T + translation - target, axis=1)


def _of_all(model: Solution, chosen: np.ndarray, whole: Solution) -> Solution:
    """A solution of some images as one of all."""
    count = len(whole.names)

    def spread(values: np.ndarray, empty: np.ndarray) -> np.ndarray:
        result = np.repeat(empty[None], count, axis=0)
        result[chosen] = values
        return result

    observations, held = model.observations.copy(), model.held_out_observations.copy()
    for rows in (observations, held):
        rows[:, 1] = chosen[rows[:, 1]]
    lenses = {whole.cameras[i]: lens for i, lens in zip(chosen, model.cameras, strict=True)}
    first, second = (int(chosen[i]) for i in model.initial_pair)
    moving = model.velocities
    return dataclasses.replace(
        model,
        names=whole.names,
        cameras=[lenses.get(camera, camera) for camera in whole.cameras],
        registered=spread(model.registered, np.zeros((), bool)),
        camera_from_world=spread(model.camera_from_world, np.eye(4)),
        covariances=spread(model.covariances, np.zeros((6, 6))),
        velocities=None if moving is None else spread(moving, np.zeros(6)),
        observations=observations,
        initial_pair=(first, second),
        held_out_observations=held,
    )
