"""Weighs the focal length that images determine against the one that a camera or a user states."""

from __future__ import annotations

import concurrent.futures
import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np

from gsut import _core
from gsut._core import SolveError
from gsut.judge import SURE
from gsut.lens import Camera, FocalPrior, find_focal_params, with_scaled_focal
from gsut.sfm.lens.candidates import guess_lens
from gsut.sfm.lens.covariance import estimate_lens_sigmas
from gsut.sfm.lens.information import GROUPS, split_windows
from gsut.sfm.mapping import Mapping
from gsut.sfm.matches import TRIAL_MATCHES, keep_most_distinct
from gsut.sfm.solution import (
    Adjustment,
    LensFlags,
    ReadoutMotion,
    Solution,
    adjust_registered,
    index_lenses,
)
from gsut.significance import convert_to_normal

# Standard deviation of the logarithm of a focal length by --fov, which is a rough field of view,
# and by a lens of the database, of which cameras have several modes.
_STATED = 0.05
# Fewest images of which some can be left out and the others still determine a lens: how well it is
# known cannot be measured with fewer.
_FEWEST_IMAGES = 4
# Most matches of a pair in adjustments of windows, which are many.
_WINDOW_MATCHES = 50
# Most images whose groups are left out: of more, which would be eight adjustments of nearly all,
# windows are adjusted alone.
_MOST_LEFT_OUT = 100
# Share of the prior's standard deviation below which the images alone know better.
_NEGLIGIBLE = 0.1

_Found = TypeVar("_Found")


def weigh_focal_prior(mapping: Mapping, features_sigma: float) -> tuple[Mapping, float]:
    """Moves the focal length to the weighted mean of images and prior, where the two agree.

    Everything else is adjusted again with that focal length held.

    Args:
        features_sigma: standard deviation of the logarithm of the focal length by the errors of
            the features alone.

    Returns:
        The run with solution, and "focal_prior" of the figures where there is a prior; and
        the standard deviation of the logarithm of the focal length.
    """
    solution, flags = mapping.solved, mapping.one_lens_free
    if flags is None:
        return mapping, features_sigma
    sigma = estimate_focal_sigma(mapping, flags, features_sigma)
    prior = _find_prior(mapping)
    if prior is None:
        return mapping, sigma
    focal = find_focal(solution)
    gap = math.log(focal / prior.px)
    apart = convert_to_normal(gap / math.hypot(sigma, prior.sigma), GROUPS - 1)
    agrees = bool(apart <= SURE)
    share = 1 / (1 + (sigma / prior.sigma) ** 2) if math.isfinite(sigma) else 0.0  # of the images
    both = prior.sigma * math.sqrt(1 - share)
    held = None
    if agrees and sigma > _NEGLIGIBLE * prior.sigma and solution.shutter is None:
        held = _hold_focal(mapping, flags, math.exp((share - 1) * gap))
    known = f"{focal:.0f} px, known to {200 * sigma:.1f} % (two standard deviations)"
    figures = {
        "source": prior.source, "px": prior.px, "sigma_percent": 100 * prior.sigma,
        "images_px": focal,
        "images_sigma_percent": 100 * sigma if math.isfinite(sigma) else None,
        "agrees": agrees, "used": held is not None,
    }  # fmt: skip
    mapping = mapping.add_findings({"focal_prior": figures})
    if not agrees:
        mapping.log.note(
            f"the images give a focal length of {known}, which contradicts the {prior.px:.0f} px "
            f"of {prior.source}: these are not used, as photographs may be cropped or corrected in "
            "the camera; if renders look bent, give the lens by --camera"
        )
    if held is None:
        return mapping, sigma
    if share < 0.5:
        alone = f"a focal length of {known}" if sigma < 1 else "no focal length"
        mapping.log.note(
            f"the images alone give {alone}; with the {prior.px:.0f} px of {prior.source} it is "
            f"{find_focal(held):.0f} px, known to {200 * both:.1f} %"
        )
    return mapping.replace(solution=held), both


def _find_prior(mapping: Mapping) -> FocalPrior | None:
    """Finds what is stated of the focal length: by the user, else by the photographs."""
    photographs, camera = mapping.photographs, mapping.solved.cameras[0]
    if mapping.options.fov is not None:
        start = guess_lens(camera.width, camera.height, mapping.options.fov)
        return FocalPrior(float(start.params[0]), _STATED, "--fov")
    if photographs.profile is not None:
        start = photographs.profile.make_camera(camera.width, camera.height)
        return FocalPrior(float(start.params[0]), _STATED, photographs.profile.name)
    if photographs.exif_focal_px is None or photographs.focal_sigma is None:
        return None
    return FocalPrior(photographs.exif_focal_px, photographs.focal_sigma, "EXIF")


def find_focal(solution: Solution) -> float:
    """Returns the focal length in pixels that the one lens of a solution has."""
    return _get_focal(solution.cameras[int(np.flatnonzero(solution.registered)[0])])


def _get_focal(camera: Camera) -> float:
    return float(camera.params[find_focal_params(camera)[0]])


def _hold_focal(mapping: Mapping, flags: np.ndarray, factor: float) -> Solution | None:
    """Adjusts everything but the focal length, changed by a factor; None if images are lost."""
    solution = mapping.solved
    lens = with_scaled_focal(solution.cameras[0], factor)
    start = dataclasses.replace(solution, cameras=[lens] * len(solution.cameras))
    free = flags.copy()
    free[find_focal_params(lens)] = 0
    adjustment = Adjustment(free, extend=True, turns=mapping.turns)
    try:
        held = adjust_registered(
            start, mapping.features, mapping.pairs, mapping.options,
            mapping.log.follow_steps("mapping"), adjustment,
        )  # fmt: skip
    except SolveError:
        return None
    return held if held.num_registered == solution.num_registered else None


def estimate_focal_sigma(mapping: Mapping, flags: LensFlags, features_sigma: float) -> float:
    """Estimates the standard deviation of the logarithm of the focal length by the images alone.

    That of the features' errors, but at least how much the focal length varies when one group of
    images after the other is left out (the jackknife), or between windows of many images: what
    features share, a shutter, a lens of another shape and wrong matches hardly raise the residuals.
    Infinite for fewer than four images. Of several lenses that of the least known one; of many
    images of several lenses, or of a rig, the features' alone.
    """
    solution = mapping.solved
    if solution.num_registered < _FEWEST_IMAGES:
        return math.inf
    spread = 0.0
    if solution.num_registered > _MOST_LEFT_OUT:
        if isinstance(flags, np.ndarray):
            spread = _measure_spread_of_windows(mapping, solution, flags)
    elif isinstance(flags, np.ndarray) or mapping.photographs.frames is None:
        spread = _measure_spread_without_groups(mapping, solution, flags)
    return max(features_sigma, spread)


def _measure_spread_without_groups(mapping: Mapping, solution: Solution, flags: LensFlags) -> float:
    """Measures how much focal lengths vary when one group after the other is left out.

    Returns:
        Of the lens that varies most; infinite where one is found fewer than twice.
    """
    images = np.flatnonzero(solution.registered)
    lenses = index_lenses(solution.cameras, flags)
    of_image = np.array(lenses.of_image)
    estimated = [i for i in np.unique(of_image[images]) if lenses.free[i] is not None]

    def find_without(group: np.ndarray) -> list[float | None]:
        """Finds the logarithm of each focal length without a group; None: too few are left."""
        kept = np.setdiff1d(images, group)
        found = _adjust_some(mapping, solution, flags, kept, TRIAL_MATCHES)
        if found is None:
            return [None] * len(estimated)
        own = [np.flatnonzero(found.registered & (of_image == lens)) for lens in estimated]
        return [math.log(_get_focal(found.cameras[o[0]])) if len(o) else None for o in own]

    groups = np.array_split(images, min(GROUPS, len(images)))
    found = _run_beside(find_without, groups)
    by_lens = [[log for log in logs if log is not None] for logs in zip(*found, strict=True)]
    return max(
        math.sqrt((len(logs) - 1) * float(np.var(logs))) if len(logs) > 1 else math.inf
        for logs in by_lens
    )


def _measure_spread_of_windows(mapping: Mapping, solution: Solution, flags: np.ndarray) -> float:
    """Measures how well the mean of windows' focal lengths is known, by how far they are apart.

    Each window of images that share many points is adjusted alone, and weighted by the variance of
    its focal length that its features' errors cause.
    """

    def find_alone(window: np.ndarray) -> tuple[float, float] | None:
        """Finds the logarithm of a window's focal length, and its weight; None: undetermined."""
        found = _adjust_some(mapping, solution, flags, window, _WINDOW_MATCHES)
        if found is None:
            return None
        try:
            (known,) = estimate_lens_sigmas(found, flags)
        except SolveError:
            return None
        focal = find_focal(found)
        return math.log(focal), (focal / float(known[0])) ** 2

    point, image = solution.observations[:, 0], solution.observations[:, 1]
    windows = split_windows(image, point, len(solution.names), GROUPS)
    found = _run_beside(find_alone, windows)
    values = np.array([each for each in found if each is not None])
    if len(values) < 2:
        return math.inf
    log, weight = values.T
    away = weight * (log - np.average(log, weights=weight))
    return math.sqrt(len(log) / (len(log) - 1) * float(away @ away)) / float(weight.sum())


def _run_beside(
    adjust: Callable[[np.ndarray], _Found], groups: Sequence[np.ndarray]
) -> list[_Found]:
    """Adjusts groups of images beside each other: one that is small leaves cores idle."""
    with concurrent.futures.ThreadPoolExecutor(_core.num_threads()) as pool:
        return list(pool.map(adjust, groups))


def _adjust_some(
    mapping: Mapping,
    solution: Solution,
    flags: LensFlags,
    images: np.ndarray,
    matches: int,
) -> Solution | None:
    """Adjusts some images, by the most distinct matches; None where too few are left."""
    # A focal length without the readout would vary by how the images move.
    registered = np.isin(np.arange(len(solution.names)), images)
    start = dataclasses.replace(solution, registered=registered)
    pairs = keep_most_distinct(mapping.pairs, matches)
    motion = ReadoutMotion.hold(solution)
    adjustment = Adjustment(
        flags, lens_settled=True, motion=motion, covariances=False, turns=mapping.turns
    )
    try:
        return adjust_registered(
            start, mapping.features, pairs, mapping.options, adjustment=adjustment
        )
    except SolveError:
        return None
