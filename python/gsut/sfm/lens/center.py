"""Estimates principal point and shape of pixels of the one lens, once all poses are known."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from gsut._core import SolveError
from gsut.judge import SURE
from gsut.lens import Camera
from gsut.sfm.mapping import Mapping
from gsut.sfm.matches import PairMatches, keep_most_distinct
from gsut.sfm.solution import CENTER, Adjustment, LensFlag, Solution


def free_center(mapping: Mapping) -> Mapping:
    """Estimates principal point and shape of pixels with everything else, as far as priors say.

    The middle and square pixels were assumed so far. They stay where the lens is known, under a
    rolling shutter, for two lenses in one frame, and for a video that may have a rolling shutter.
    Nothing else decides: where images say little of them, their priors hold them.

    Returns:
        The run with solution and `lens_free`.
    """
    solution, flags, photographs = mapping.solved, mapping.one_lens_free, mapping.photographs
    if flags is None or solution.shutter is not None or photographs.frames is not None:
        return mapping
    signs = mapping.found.figures.get("shutter_signs", math.inf)
    if photographs.flows and mapping.options.shutter == "auto" and not signs < SURE:
        return mapping
    freed = flags.copy()
    freed[list(CENTER)] = LensFlag.FREE
    freed[1] = LensFlag.NEAR
    try:
        # Poses that a wrong centre bent straighten up in the first adjustment.
        free = _adjust(mapping, solution, keep_most_distinct(mapping.pairs), freed)
        free = _adjust(mapping, free, mapping.pairs, freed, is_last=True)
    except SolveError:
        return mapping
    if free.num_registered < solution.num_registered:
        return mapping
    free = dataclasses.replace(free, initial_pair=solution.initial_pair, restarts=solution.restarts)
    return mapping.replace(solution=free, lens_free=freed)


def _adjust(
    mapping: Mapping,
    start: Solution,
    pairs: Sequence[PairMatches],
    flags: np.ndarray,
    is_last: bool = False,
) -> Solution:
    """Adjusts everything with these parameters of the lens free."""
    adjustment = Adjustment(flags, lens_settled=is_last, covariances=is_last, extend=is_last)
    return mapping.adjust(adjustment, start, pairs, "mapping")


def _measure_off(lens: Camera) -> tuple[np.ndarray, float]:
    """Measures (2,) pixels from the picture's middle to the principal point, and their prior."""
    off = lens.params[list(CENTER)] - [lens.width / 2, lens.height / 2]
    return off, Adjustment.center_sigma * math.hypot(lens.width, lens.height)


def describe_center(mapping: Mapping, lens: Camera, known: np.ndarray | None) -> Mapping:
    """Adds the principal point of the one lens to the figures, and a note if it deserves one.

    Args:
        mapping: with the flags of the lens.
        lens: as estimated.
        known: standard deviations of its parameters; None: not determined.
    """
    off, prior = _measure_off(lens)
    flags = mapping.one_lens_free
    is_free = flags is not None and bool(flags[list(CENTER)].all())
    sigma = known[list(CENTER)] if known is not None and is_free else np.full(2, prior)
    figures = {
        "off_px": off.tolist(), "sigma_px": sigma.tolist(), "estimated": is_free,
    }  # fmt: skip
    if is_free and (np.abs(off) > SURE * sigma).any():
        mapping.log.note(
            f"the principal point lies {off[0]:+.1f}, {off[1]:+.1f} px off the middle of the "
            f"picture (standard deviation {sigma.max():.1f} px)"
        )
    elif 2 * sigma.max() ** 2 > prior**2:  # the images say less of it than the prior
        turn = math.degrees(math.atan2(float(sigma.max()), float(lens.params[0])))
        way = "these images leave it open" if is_free else "it was not estimated"
        mapping.log.keep(
            f"the principal point is taken to be near the middle of the picture ({way}): all "
            f"cameras may be turned alike by {turn:.1f} degrees (standard deviation)"
        )
    return mapping.add_findings({"principal_point": figures})
