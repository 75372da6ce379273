"""Weighs the focal length that images determine against the one that a camera or a user states."""

from __future__ import annotations

import contextlib
import dataclasses
import math

import numpy as np

from gsut._core import SolveError
from gsut.judge import SURE
from gsut.judge.checks import FOCAL_LIMIT
from gsut.lens import FocalPrior, find_focal_params, with_scaled_focal
from gsut.sfm.lens.candidates import guess_lens
from gsut.sfm.lens.covariance import estimate_focal_spread
from gsut.sfm.lens.information import GROUPS
from gsut.sfm.mapping import Mapping
from gsut.sfm.matches import keep_most_distinct
from gsut.sfm.solution import (
    Adjustment,
    LensFlags,
    ReadoutMotion,
    Solution,
    adjust_registered,
    compare_solutions,
)
from gsut.significance import convert_to_normal

# Standard deviation of the logarithm of a focal length by --fov, which is a rough field of view,
# and by a lens of the database, of which cameras have several modes.
_STATED = 0.05
# Fewest images of which some can be left out and the others still determine a lens: how well it is
# known cannot be measured with fewer.
_FEWEST_IMAGES = 4
# Most images that are adjusted anew without a group. Of more, one linear step must do, which said a
# third of it of a capture of 50.
_MOST_ADJUSTED = 100
# Factor by which a focal length must not change without the matches clearly saying so.
_FAR = 1.25
# Share of the prior's standard deviation below which the images alone know better.
_NEGLIGIBLE = 0.1


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
    if FOCAL_LIMIT < sigma < math.log(_FAR) and not _is_determined(mapping, flags):
        sigma = math.log(_FAR)
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
        held = hold_focal(mapping, flags, math.exp((share - 1) * gap))
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


def _is_determined(mapping: Mapping, flags: np.ndarray) -> bool:
    """Returns whether matches clearly speak against a focal length far from the one found.

    How it varies without some of the images is no evidence of that: where all of them leave it
    open, each of their groups keeps the one that was found.
    """
    found, *others = (hold_focal(mapping, flags, factor) for factor in (1.0, 1 / _FAR, _FAR))
    if found is None:
        return True
    gains = [
        compare_solutions(found, other, mapping.features, mapping.pairs)
        for other in others
        if other is not None
    ]
    return all(each.gain < -SURE * each.sigma for each in gains)


def find_focal(solution: Solution) -> float:
    """Returns the focal length in pixels that the one lens of a solution has."""
    camera = solution.cameras[int(np.flatnonzero(solution.registered)[0])]
    return float(camera.params[find_focal_params(camera)[0]])


def hold_focal(mapping: Mapping, flags: np.ndarray, factor: float) -> Solution | None:
    """Adjusts everything but the focal length, changed by a factor; None if images are lost."""
    solution = mapping.solved
    lens = with_scaled_focal(solution.cameras[0], factor)
    start = dataclasses.replace(solution, cameras=[lens] * len(solution.cameras))
    free = flags.copy()
    free[find_focal_params(lens)] = 0
    adjustment = Adjustment(
        free, extend=True, motion=ReadoutMotion.hold(solution), turns=mapping.turns
    )
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

    That of the features' errors, but at least how much the focal length varies without some of the
    images: what features share, a shutter, a lens of another shape and wrong matches hardly raise
    the residuals. Infinite for fewer than four images. Of several lenses that of the least known.
    """
    solution = mapping.solved
    if solution.num_registered < _FEWEST_IMAGES:
        return math.inf
    is_one = isinstance(flags, np.ndarray) and mapping.photographs.frames is None
    if is_one and solution.num_registered <= _MOST_ADJUSTED:
        return max(features_sigma, adjust_without_groups(mapping, flags))
    return max(features_sigma, estimate_focal_spread(solution, flags, mapping.turns))


def adjust_without_groups(mapping: Mapping, flags: LensFlags) -> float:
    """Measures what `estimate_focal_spread` does, by adjusting: few images are far from linear.

    Infinite where too few images are left without a group.
    """
    solution, logs = mapping.solved, []
    pairs, images = keep_most_distinct(mapping.pairs), np.flatnonzero(solution.registered)
    adjustment = Adjustment(
        flags, lens_settled=True, motion=ReadoutMotion.hold(solution), covariances=False,
        turns=mapping.turns,
    )  # fmt: skip
    for group in np.array_split(images, min(GROUPS, len(images))):
        registered = solution.registered & ~np.isin(np.arange(len(solution.names)), group)
        start = dataclasses.replace(solution, registered=registered)
        with contextlib.suppress(SolveError):  # too few are left
            found = adjust_registered(
                start, mapping.features, pairs, mapping.options, adjustment=adjustment
            )
            logs.append(math.log(find_focal(found)))
    return math.sqrt((len(logs) - 1) * float(np.var(logs))) if len(logs) > 1 else math.inf
