"""Compares the focal length of a given lens with the one that the photographs determine."""

from __future__ import annotations

import math

import numpy as np

from gsut._core import SolveError
from gsut.judge.checks import FOCAL_LIMIT
from gsut.lens import Camera, find_focal_params, has_focal_length
from gsut.sfm.lens.covariance import estimate_lens_covariances
from gsut.sfm.lens.prior import count_groups, estimate_focal_sigma, find_focal
from gsut.sfm.mapping import Mapping
from gsut.sfm.matches import keep_most_distinct
from gsut.sfm.solution import FEATURE_VARIANCE, Adjustment, Solution, adjust_registered
from gsut.significance import convert_to_normal

_MATCHES = 150  # of a pair, the most distinct: a focal length needs no more
_TIED = 2  # flag of the focal lengths, which change by one factor
# Standard deviations, as rare as in a normal law, beyond which photographs contradict a lens.
_CONTRADICTS = 3.0


def check_given_lens(mapping: Mapping) -> Mapping:
    """Adds to the findings how far the photographs contradict the focal length of a given lens.

    Everything is adjusted again with the focal length free. Only a difference that would lower the
    verdict is compared with its standard deviation. Does nothing for a rig, several lenses, or a
    lens that has no focal length.
    """
    solution = mapping.solved
    lens = _find_one_lens(solution)
    if lens is None or mapping.rig is not None or not len(solution.points):
        return mapping
    flags = np.zeros(len(lens.params), np.uint8)
    focal = find_focal_params(lens)
    flags[focal] = _TIED
    pairs = keep_most_distinct(mapping.pairs, _MATCHES)
    try:
        free = adjust_registered(
            solution, mapping.features, pairs, mapping.options,
            adjustment=Adjustment(flags, covariances=False),
        )  # fmt: skip
    except SolveError:  # nothing can be said
        return mapping
    given, own = float(lens.params[focal[0]]), find_focal(free)
    gap = math.log(own / given)
    figures = {"px": given, "images_px": own, "images_sigma_percent": None, "agrees": True}
    if abs(gap) <= FOCAL_LIMIT:
        return mapping.add_findings({"given_focal": figures})
    sigma = _estimate_sigma(mapping, free, flags)
    if math.isfinite(sigma):
        figures["images_sigma_percent"] = 100 * sigma
    freedom = count_groups(free) - 1
    if not math.isfinite(sigma) or convert_to_normal(gap / sigma, freedom) <= _CONTRADICTS:
        return mapping.add_findings({"given_focal": figures})
    figures["agrees"] = False
    mapping.log.note(
        f"the photographs give a focal length of {own:.1f} px, known to {200 * sigma:.1f} % (two "
        f"standard deviations), which contradicts the {given:.1f} px of the given lens; let the "
        "lens be estimated with --unknown-lens, or give the lens that took them"
    )
    return mapping.add_findings({"given_focal": figures}, focal_gap=own / given - 1)


def _find_one_lens(solution: Solution) -> Camera | None:
    """Returns the lens of all images with a pose; None if they differ or have no focal length."""
    lenses = [solution.cameras[image] for image in np.flatnonzero(solution.registered)]
    if not has_focal_length(lenses[0]) or any(lens != lenses[0] for lens in lenses[1:]):
        return None
    return lenses[0]


def _estimate_sigma(mapping: Mapping, free: Solution, flags: np.ndarray) -> float:
    """Estimates the standard deviation of the logarithm of a freed focal length."""
    try:
        (known,) = estimate_lens_covariances(free, flags, FEATURE_VARIANCE)
    except SolveError:  # the images do not determine it
        return math.inf
    by_features = float(known.sigmas[flags > 0][0] / find_focal(free))
    return estimate_focal_sigma(mapping, free, flags, by_features)
