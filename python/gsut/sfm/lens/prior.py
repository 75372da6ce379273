"""Weighs the focal length that images determine against the one that a camera or a user states."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from gsut._core import SolveError
from gsut.judge import SURE
from gsut.lens import Camera, FocalPrior, find_focal_params, with_scaled_focal
from gsut.sfm.lens.candidates import list_focal_lengths
from gsut.sfm.lens.information import GROUPS
from gsut.sfm.mapping import Mapping
from gsut.sfm.solution import (
    Adjustment,
    ReadoutMotion,
    Solution,
)
from gsut.significance import convert_to_normal

# Standard deviation of the logarithm of a focal length by --fov, a rough field of view (how much
# kinds of lenses differ comes to it), and by a lens of the database: cameras have several modes.
_STATED = 0.05
# Share of the prior's standard deviation below which the images alone know better.
_NEGLIGIBLE = 0.1


def weigh_focal_prior(mapping: Mapping, flags: np.ndarray, sigma: float) -> tuple[Mapping, float]:
    """Moves the focal length to the weighted mean of images and prior, where the two agree.

    Everything else is adjusted again with that focal length held.

    Args:
        flags: of the one lens' free parameters.
        sigma: standard deviation of the logarithm of the focal length by the images alone.

    Returns:
        The run with solution, and "focal_prior" of the figures where there is a prior; and
        the standard deviation of the logarithm of the focal length.
    """
    prior = _find_prior(mapping)
    if prior is None:
        return mapping, sigma
    focal = find_focal(mapping.solved)
    gap = math.log(focal / prior.px)
    apart = convert_to_normal(gap / math.hypot(sigma, prior.sigma), GROUPS - 1)
    agrees = bool(apart <= SURE)
    share = 1 / (1 + (sigma / prior.sigma) ** 2) if math.isfinite(sigma) else 0.0  # of the images
    both = prior.sigma * math.sqrt(1 - share)
    held = None
    if agrees and sigma > _NEGLIGIBLE * prior.sigma and mapping.solved.shutter is None:
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
        logs = np.log(list_focal_lengths(camera.width, mapping.options.fov))
        least, most = float(logs.min()), float(logs.max())
        spread = math.hypot(_STATED, (most - least) / 2)
        return FocalPrior(math.exp((least + most) / 2), spread, "--fov")
    if photographs.profile is not None:
        start = photographs.profile.make_camera(camera.width, camera.height)
        return FocalPrior(float(start.params[0]), _STATED, photographs.profile.name)
    if photographs.exif_focal_px is None or photographs.focal_sigma is None:
        return None
    return FocalPrior(photographs.exif_focal_px, photographs.focal_sigma, "EXIF")


def find_lens(solution: Solution) -> Camera:
    """Finds the one lens of the images that have a pose."""
    return solution.cameras[int(np.flatnonzero(solution.registered)[0])]


def find_focal(solution: Solution) -> float:
    """Returns the focal length in pixels that the one lens of a solution has."""
    camera = find_lens(solution)
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
        held = mapping.adjust(adjustment, start, stage="mapping")
    except SolveError:
        return None
    return held if held.num_registered == solution.num_registered else None
