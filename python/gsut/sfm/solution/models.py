"""Reconstructs the images that a solution left out, as models of their own."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from gsut._core import SolveError
from gsut.sfm.matches import PairMatches
from gsut.sfm.photographs import FEWEST_OF_MODEL, Features, Images, PosesOptions
from gsut.sfm.solution.result import Solution
from gsut.sfm.solution.solver import solve_poses


def find_further_models(
    solution: Solution,
    features: Sequence[Features],
    pairs: Sequence[PairMatches],
    options: PosesOptions,
) -> tuple[Solution, list[Solution]]:
    """Reconstructs the images that a solution left out.

    Args:
        features: of all images.
        pairs: verified matches.

    Returns:
        The largest model, and the others, largest first; each has an entry for every image.
    """
    images = Images(solution.names, solution.cameras, features, solution.shutter, solution.lines)
    found = [model for model, _ in solve_left_out(images, ~solution.registered, pairs, options)]
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
    while True:
        own = [pair for pair in pairs if left[pair.first] and left[pair.second]]
        if left.sum() < FEWEST_OF_MODEL or not own:
            return
        try:
            model = solve_poses(images, own, options)
        except SolveError:
            return
        if model.num_registered < FEWEST_OF_MODEL:
            return
        left &= ~model.registered
        yield model, own
