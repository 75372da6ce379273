"""Compares a given lens with the one that the photographs determine."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from gsut._core import SolveError
from gsut.judge import SURE, TINY
from gsut.judge.checks import NOT_GOOD
from gsut.lens import Camera, convert_camera, find_focal_params, has_focal_length
from gsut.sfm.lens.candidates import list_lens_ladder
from gsut.sfm.lens.covariance import measure_focal_sigma
from gsut.sfm.lens.differences import measure_lens_difference
from gsut.sfm.lens.jackknife import (
    adjust_without_groups,
    estimate_focal_sigma,
    measure_lens_sigma,
)
from gsut.sfm.lens.prior import find_focal, find_lens
from gsut.sfm.lens.ranking import ROUGH, LensRanking
from gsut.sfm.lens.search import FIRST_IMAGES
from gsut.sfm.mapping import Mapping
from gsut.sfm.matches import PairMatches, choose_connected_pairs, keep_most_distinct
from gsut.sfm.solution import Adjustment, LensFlag, LensFlags, Solution, measure_diagonal
from gsut.significance import convert_to_normal


def check_given_lens(mapping: Mapping) -> Mapping:
    """Adds to the findings how far the photographs contradict a given lens.

    Some images are adjusted again with the focal length and the first radial coefficient free.
    Where the lens then differs by more than good poses allow, it must also differ by more than it
    varies without some of these images, or clearly fewer matches of two images must agree through
    it than through a rough one: poses through a wrong lens determine no other. Does nothing for a
    rig, several lenses, a lens that has no focal length, or too few images.
    """
    solution = mapping.solved
    lens = _find_one_lens(mapping)
    if lens is None or mapping.rig is not None or not len(solution.points):
        return mapping
    trial, flags = _free_lens(lens)
    posed = [p for p in mapping.pairs if solution.registered[[p.first, p.second]].all()]
    pairs = keep_most_distinct(choose_connected_pairs(posed, FIRST_IMAGES))
    try:
        free = _adjust(mapping, trial, pairs, flags)
    except SolveError:  # nothing can be said
        return mapping
    given, found = float(lens.params[find_focal_params(lens)[0]]), find_focal(free)
    gap = measure_lens_difference(trial, find_lens(free))
    figures: dict[str, float] = {"px": given}
    doubt = ""
    if gap > NOT_GOOD * measure_diagonal([lens]):
        some = mapping.replace(solution=free, pairs=pairs)
        without = adjust_without_groups(some, flags)
        if without is not None and len(without) > 1:
            by_features = measure_focal_sigma(free, flags)[0]
            spread = estimate_focal_sigma(some, flags, by_features, without)
            figures["images_sigma_percent"] = 100 * spread
            figures["sigma_px"] = sigma = measure_lens_sigma(without, spread)
            if gap > SURE * sigma:
                doubt = f"standard deviation {sigma:.1f} px"
        if not doubt:
            rough, doubt = _compare_with_rough_lenses(mapping, lens)
            if doubt:
                gap, found = measure_lens_difference(lens, rough), float(rough.params[0])
    figures |= {"images_px": found, "difference_px": gap, "agrees": not doubt}
    mapping = mapping.add_findings({"given_lens": figures})
    if not doubt:
        return mapping
    mapping.log.note(
        f"the photographs give a lens that differs by {gap:.1f} px over the picture from the given "
        f"one ({doubt}), with a focal length of {found:.1f} px for {given:.1f}; let the lens "
        "be estimated with --unknown-lens, or give the lens that took them"
    )
    return mapping.add_findings(lens_gap_px=gap, focal_gap=found / given - 1)


def _compare_with_rough_lenses(mapping: Mapping, lens: Camera) -> tuple[Camera, str]:
    """Finds the lens of the ladder through which most matches of two images agree.

    Returns:
        It, and by how many it is better than the given one; nothing where that is not by three
        standard deviations over pairs of images.
    """
    factor = 1.0 if mapping.shutter is None else ROUGH
    ranking = LensRanking(mapping.features, mapping.raw, mapping.options, factor)
    ladder = list_lens_ladder(lens.width, lens.height, None)
    best = ranking.rank_lenses([], ladder, lambda *_: None)[0]
    rough, own, other = best.camera, ranking.measure_shares(lens), best.shares
    gains = other - own
    if len(gains) < 2 or gains.mean() <= 0:
        return rough, ""
    t = gains.mean() * math.sqrt(len(gains)) / max(gains.std(ddof=1), TINY)
    if convert_to_normal(t, len(gains) - 1) <= SURE:
        return rough, ""
    return rough, (
        f"{100 * own.mean():.0f} % of the matches of two images agree through the given one, "
        f"{100 * other.mean():.0f} % through a rough one"
    )


def _free_lens(lens: Camera) -> tuple[Camera, np.ndarray]:
    """Returns the lens with a radial coefficient, if it can have one, and flags of what is free."""
    if lens.model == "pinhole":
        lens = convert_camera(lens, "opencv4").camera
    names = lens.param_names.split()
    flags = np.zeros(len(lens.params), np.uint8)
    flags[find_focal_params(lens)] = LensFlag.TIED
    if "k1" in names:
        flags[names.index("k1")] = LensFlag.FREE
    return lens, flags


def _find_one_lens(mapping: Mapping) -> Camera | None:
    """Returns the lens of all images with a pose; None if they differ or have no focal length."""
    solution = mapping.solved
    lenses = [solution.cameras[image] for image in np.flatnonzero(solution.registered)]
    if not has_focal_length(lenses[0]) or any(lens != lenses[0] for lens in lenses[1:]):
        return None
    return lenses[0]


def _adjust(mapping: Mapping, lens: Camera, pairs: list[PairMatches], flags: LensFlags) -> Solution:
    """Adjusts the images of some pairs through a lens of which these parameters are free."""
    solution = mapping.solved
    images = {image for pair in pairs for image in (pair.first, pair.second)}
    some = solution.registered & np.isin(np.arange(len(solution.names)), list(images))
    start = dataclasses.replace(solution, registered=some, cameras=[lens] * len(solution.cameras))
    return mapping.adjust(Adjustment(flags, covariances=False), start, pairs)
