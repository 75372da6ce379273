"""Estimates the principal point of the one lens, once the poses of all photographs are known."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from gsut._core import SolveError
from gsut.lens import Camera
from gsut.sfm.lens.candidates import explain_implausible
from gsut.sfm.lens.covariance import LensCovariance, estimate_lens_covariances
from gsut.sfm.lens.critical_motion import find_critical_motion
from gsut.sfm.mapping import Mapping
from gsut.sfm.matches import keep_most_distinct
from gsut.sfm.solution import (
    CENTER,
    CENTER_SIGMA,
    FEATURE_VARIANCE,
    Adjustment,
    Solution,
    adjust_registered,
)

# Standard deviations from nothing of a video's readout time above which a rolling shutter is
# suspected: a camera that walks while it reads its lines looks like one of another centre.
_SUSPECTED = 2.0
# Share of the prior's standard deviation below which images determine a principal point.
_DETERMINED = 0.5
# Standard deviations from the middle of the picture that are beyond doubt and deserve a note.
_CLEARLY_OFF = 3.0
_TRIAL_MATCHES = 150  # of a pair, the most distinct, in a first adjustment
_FREE = 1  # flag of a parameter that is estimated by itself


def free_center(mapping: Mapping) -> Mapping:
    """Estimates the principal point with everything else, near the middle as far as priors say.

    The middle was assumed so far. It stays where the lens is known, under a rolling shutter, for
    two lenses in one frame, for a video that may have a rolling shutter, after a motion that leaves
    the lens open, and unless the images clearly place it elsewhere: without that evidence two more
    unknowns only cost accuracy.

    Returns:
        The run with solution and `lens_free`.
    """
    solution, flags, photographs = mapping.solved, mapping.one_lens_free, mapping.photographs
    if flags is None or solution.shutter is not None or photographs.frames is not None:
        return mapping
    if photographs.flows and not mapping.found.figures.get("shutter_signs", math.inf) < _SUSPECTED:
        return mapping
    if find_critical_motion(solution, mapping.pairs) is not None:
        return mapping
    freed = flags.copy()
    freed[list(CENTER)] = _FREE
    found = solution
    few = keep_most_distinct(mapping.pairs, _TRIAL_MATCHES)
    try:
        # Poses that a wrong centre bent straighten up in the first adjustment.
        for pairs, is_last in ((few, False), (mapping.pairs, True)):
            found = adjust_registered(
                found, mapping.features, pairs, mapping.options,
                mapping.log.follow_steps("mapping"),
                Adjustment(freed, covariances=is_last, extend=is_last),
            )  # fmt: skip
    except SolveError:
        return mapping
    if found.num_registered < solution.num_registered:
        return mapping
    lens = found.cameras[int(np.flatnonzero(found.registered)[0])]
    is_off = _is_clearly_off(found, lens, freed)
    if is_off and explain_implausible(lens, mapping.features) is None:
        found = dataclasses.replace(
            found, initial_pair=solution.initial_pair, restarts=solution.restarts
        )
        return mapping.replace(solution=found, lens_free=freed)
    return mapping


def _is_clearly_off(solution: Solution, lens: Camera, flags: np.ndarray) -> bool:
    """Decides whether the principal point differs from the middle beyond doubt."""
    try:
        known = estimate_lens_covariances(solution, flags, FEATURE_VARIANCE)[0]
    except SolveError:
        return False
    off = lens.params[list(CENTER)] - [lens.width / 2, lens.height / 2]
    return bool(np.linalg.norm(off / known.sigmas[list(CENTER)]) > _CLEARLY_OFF)


def describe_center(mapping: Mapping, lens: Camera, known: LensCovariance | None) -> Mapping:
    """Adds the principal point of the one lens to the figures, and a note if it deserves one.

    Args:
        mapping: with the flags of the lens.
        lens: as estimated.
        known: its covariance; None: not determined.
    """
    prior = CENTER_SIGMA * math.hypot(lens.width, lens.height)
    flags = mapping.one_lens_free
    is_free = flags is not None and bool(flags[list(CENTER)].all())
    sigma = known.sigmas[list(CENTER)] if known is not None and is_free else np.full(2, prior)
    off = lens.params[list(CENTER)] - [lens.width / 2, lens.height / 2]
    figures = {
        "off_px": off.tolist(), "sigma_px": sigma.tolist(), "estimated": is_free,
    }  # fmt: skip
    if is_free and (np.abs(off) > _CLEARLY_OFF * sigma).any():
        mapping.log.note(
            f"the principal point lies {off[0]:+.1f}, {off[1]:+.1f} px off the middle of the "
            f"picture (standard deviation {sigma.max():.1f} px)"
        )
    elif sigma.max() > _DETERMINED * prior:
        turn = math.degrees(math.atan2(float(sigma.max()), float(lens.params[0])))
        way = "these images leave it open" if is_free else "it was not estimated"
        mapping.log.note(
            f"the principal point is taken to be near the middle of the picture ({way}): all "
            f"cameras may be turned alike by {turn:.1f} degrees (standard deviation)"
        )
    return mapping.add_findings({"principal_point": figures})
