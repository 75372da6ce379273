"""Adjusts everything without one group of images after the other: how well it is known.

The jackknife (Efron, "The Jackknife, the Bootstrap and Other Resampling Plans", 1982) counts what
residuals hardly show: a shutter, a lens of another shape, wrong matches, another minimum.
"""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import math
from collections.abc import Sequence

import numpy as np

from gsut._core import SolveError
from gsut.judge import MEDIAN_DEVIATION
from gsut.lens import with_scaled_focal
from gsut.sfm.lens.covariance import estimate_focal_spread
from gsut.sfm.lens.differences import measure_lens_difference, measure_pose_differences
from gsut.sfm.lens.information import GROUPS
from gsut.sfm.lens.prior import find_focal, find_lens
from gsut.sfm.mapping import Mapping
from gsut.sfm.matches import ALL_UP_TO, keep_most_distinct
from gsut.sfm.photographs import FEWEST_OF_MODEL
from gsut.sfm.solution import (
    Adjustment,
    LensFlags,
    ReadoutMotion,
    Solution,
)


def adjust_without_groups(mapping: Mapping, flags: LensFlags) -> list[Solution] | None:
    """Adjusts poses, points and the one lens without each of `GROUPS` groups of images.

    Returns:
        The solutions that hold; None for fewer than four images, many, several lenses or a rig.
    """
    solution, found = mapping.solved, []
    images, is_one = np.flatnonzero(solution.registered), isinstance(flags, np.ndarray)
    if not is_one or mapping.photographs.frames is not None:
        return None
    # Of more images one linear step must do, which said a third of it of a capture of 50.
    if not FEWEST_OF_MODEL <= len(images) <= ALL_UP_TO:
        return None
    pairs = keep_most_distinct(mapping.pairs)
    adjustment = Adjustment(
        flags, lens_settled=True, motion=ReadoutMotion.hold(solution), covariances=False,
        turns=mapping.turns,
    )  # fmt: skip
    for group in np.array_split(images, min(GROUPS, len(images))):
        registered = solution.registered & ~np.isin(np.arange(len(solution.names)), group)
        start = dataclasses.replace(solution, registered=registered)
        with contextlib.suppress(SolveError):  # too few are left
            found.append(mapping.adjust(adjustment, start, pairs))
    return found


def estimate_focal_sigma(
    mapping: Mapping, flags: LensFlags, features_sigma: float, without: Sequence[Solution] | None
) -> float:
    """Estimates the standard deviation of the logarithm of the focal length by the images alone.

    That of the features' errors, but at least how much the focal length varies without some of the
    images. Infinite for fewer than four images. Of several lenses that of the least known.

    Args:
        flags: of the lenses' free parameters.
        features_sigma: by the errors of the features alone.
        without: see `adjust_without_groups`.
    """
    if mapping.solved.num_registered < FEWEST_OF_MODEL:
        return math.inf
    if without is not None:
        return max(features_sigma, measure_focal_spread(without))
    return max(features_sigma, estimate_focal_spread(mapping.solved, flags, mapping.turns))


def measure_focal_spread(without: Sequence[Solution]) -> float:
    """Measures the standard deviation of the logarithm of the focal length; infinite of none."""
    logs = [math.log(find_focal(each)) for each in without]
    return math.sqrt((len(logs) - 1) * float(np.var(logs))) if len(logs) > 1 else math.inf


def measure_pose_errors(solution: Solution, without: Sequence[Solution]) -> tuple[float, float]:
    """Measures the probable errors of poses by how far they are from those without a group.

    A start or a prior that only some images hold counts. The median of the groups, as a few images
    may hang on one of them alone.

    Args:
        without: two or more, see `adjust_without_groups`.

    Returns:
        Pixels that nine and six in ten pairs of images stay below, infinite where no group leaves
        both images a pose.
    """
    apart = [measure_pose_differences(each, solution, solution) for each in without]
    middle = np.ma.filled(np.ma.median(np.ma.masked_invalid(apart), axis=0), np.inf)
    factor = math.sqrt(len(without) - 1) / MEDIAN_DEVIATION
    most, many = factor * np.quantile(middle, (0.9, 0.6), method="higher")
    return float(most), float(many)


def measure_lens_sigma(without: Sequence[Solution], focal_sigma: float) -> float:
    """Measures the standard deviation of the lens over a picture, in pixels.

    As without some of the images, and by what the focal length is less sure than these say: what
    nothing holds is the same in all of them. Less where a prior knows the focal length better.

    Args:
        without: two or more, see `adjust_without_groups`.
        focal_sigma: standard deviation of the logarithm of the focal length.
    """
    count, spread = len(without), measure_focal_spread(without)
    lenses = [find_lens(each) for each in without]
    squared = [measure_lens_difference(*two) ** 2 for two in itertools.combinations(lenses, 2)]
    own = (count - 1) * math.sqrt(np.mean(squared) / (2 * count))
    if focal_sigma <= spread:
        return own * focal_sigma / spread
    more = min(math.sqrt(focal_sigma**2 - spread**2), 1.0)  # a factor of e is all of a picture
    longer = with_scaled_focal(lenses[0], math.exp(more))
    return math.hypot(own, measure_lens_difference(lenses[0], longer))
