"""Compares the focal length of a given lens with the one that the photographs determine."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from gsut._core import SolveError
from gsut.judge import SURE
from gsut.judge.checks import FOCAL_LIMIT
from gsut.lens import Camera, find_focal_params, has_focal_length
from gsut.sfm.lens.covariance import estimate_lens_sigmas
from gsut.sfm.lens.jackknife import adjust_without_groups, estimate_focal_sigma
from gsut.sfm.lens.prior import find_focal
from gsut.sfm.lens.search import FIRST_IMAGES
from gsut.sfm.mapping import Mapping
from gsut.sfm.matches import PairMatches, choose_connected_pairs, keep_most_distinct
from gsut.sfm.solution import (
    Adjustment,
    LensFlag,
    LensFlags,
    Solution,
    adjust_registered,
)


def check_given_lens(mapping: Mapping) -> Mapping:
    """Adds to the findings how far the photographs contradict the focal length of a given lens.

    Some images are adjusted again with the focal length free. Where the difference would lower the
    verdict and is more than the features' errors explain, it must also be more than the focal
    length varies without some of these images. Does nothing for a rig, several lenses, or a lens
    that has no focal length.
    """
    solution = mapping.solved
    lens = _find_one_lens(mapping)
    if lens is None or mapping.rig is not None or not len(solution.points):
        return mapping
    flags = np.zeros(len(lens.params), np.uint8)
    focal = find_focal_params(lens)
    flags[focal] = LensFlag.TIED
    posed = [p for p in mapping.pairs if solution.registered[[p.first, p.second]].all()]
    pairs = keep_most_distinct(choose_connected_pairs(posed, FIRST_IMAGES))
    try:
        free = _adjust(mapping, pairs, flags)
        (known,) = estimate_lens_sigmas(free, flags)
        given, own = float(lens.params[focal[0]]), find_focal(free)
        sigma = float(known[focal[0]]) / own
        gap = abs(math.log(own / given))
        if gap > max(FOCAL_LIMIT, SURE * sigma):
            some = mapping.replace(solution=free, pairs=pairs)
            sigma = estimate_focal_sigma(some, flags, sigma, adjust_without_groups(some, flags))
        agrees = gap <= max(FOCAL_LIMIT, SURE * sigma)
    except SolveError:  # nothing can be said
        return mapping
    figures = {
        "px": given, "images_px": own, "images_sigma_percent": 100 * sigma, "agrees": agrees,
    }  # fmt: skip
    if agrees:
        return mapping.add_findings({"given_focal": figures})
    mapping.log.note(
        f"the photographs give a focal length of {own:.1f} px, known to {200 * sigma:.1f} % (two "
        f"standard deviations), which contradicts the {given:.1f} px of the given lens; let the "
        "lens be estimated with --unknown-lens, or give the lens that took them"
    )
    return mapping.add_findings({"given_focal": figures}, focal_gap=own / given - 1)


def _find_one_lens(mapping: Mapping) -> Camera | None:
    """Returns the lens of all images with a pose; None if they differ or have no focal length."""
    solution = mapping.solved
    lenses = [solution.cameras[image] for image in np.flatnonzero(solution.registered)]
    if not has_focal_length(lenses[0]) or any(lens != lenses[0] for lens in lenses[1:]):
        return None
    return lenses[0]


def _adjust(mapping: Mapping, pairs: list[PairMatches], flags: LensFlags) -> Solution:
    """Adjusts the images of some pairs, with these parameters of the lens free."""
    solution = mapping.solved
    images = {image for pair in pairs for image in (pair.first, pair.second)}
    some = solution.registered & np.isin(np.arange(len(solution.names)), list(images))
    return adjust_registered(
        dataclasses.replace(solution, registered=some), mapping.features, pairs, mapping.options,
        adjustment=Adjustment(flags, covariances=False),
    )  # fmt: skip
