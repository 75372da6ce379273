"""Finds the focal length by which features and a record of turns agree."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from gsut._core import SolveError
from gsut.lens import find_focal_params
from gsut.sfm.gyroscope.evidence import SCALE_SIGMA, calibrate_poses
from gsut.sfm.lens import (
    adjust_without_groups,
    estimate_focal_sigma,
    estimate_lens_sigmas,
    find_focal,
    hold_focal,
)
from gsut.sfm.mapping import Mapping
from gsut.sfm.solution import Adjustment, ReadoutMotion, Solution, StatedTurns

# Largest factor by which features that share errors weigh less; beyond it a record decides.
_MOST_SHARED = 1e4


def find_focal_by_turns(mapping: Mapping) -> Mapping:
    """Finds the focal length by which features and recorded turns agree best.

    Features share errors, so that they know the focal length less well than their residuals say;
    leaving images out shows by how much. In an adjustment for the focal length alone they weigh
    less by that. Everything else is then adjusted again with it held.

    Returns:
        The run with solution, and "focal_prior" of the figures: focal length and standard deviation
        by both, with what record and poses disagree by beyond their errors.
    """
    solution, flags, turns = mapping.solved, mapping.one_lens_free, mapping.turns
    if flags is None or turns is None:
        return mapping
    rates = mapping.photographs.turns[mapping.found.figures["gyroscope"]["used"]]
    features_sigma = _find_formal_sigma(solution, flags, None)
    apart = mapping.replace(turns=None)
    without = adjust_without_groups(apart, flags)
    alone = estimate_focal_sigma(apart, flags, features_sigma, without)
    shared = (alone / features_sigma) ** 2 if math.isfinite(features_sigma) else _MOST_SHARED
    turns = dataclasses.replace(turns, shared=min(max(1.0, shared), _MOST_SHARED))
    adjustment = Adjustment(
        flags, lens_settled=True, motion=ReadoutMotion.hold(solution), covariances=False,
        turns=turns,
    )  # fmt: skip
    try:
        both = mapping.adjust(adjustment)
    except SolveError:
        return mapping
    focal, found = find_focal(both), calibrate_poses(mapping, both, rates)
    held = hold_focal(mapping, flags, focal / find_focal(solution))
    if held is None or found is None:
        return mapping
    sigma = _find_formal_sigma(both, flags, turns)
    excess = math.log(found.scale) ** 2 - float(found.sigmas[3]) ** 2 - SCALE_SIGMA**2
    sigma = math.hypot(sigma, math.sqrt(max(0.0, excess)))
    figures = {
        "source": "the gyroscope", "px": focal, "sigma_percent": 100 * sigma,
        "images_px": find_focal(solution),
        "images_sigma_percent": 100 * alone if math.isfinite(alone) else None,
        "agrees": excess <= 0, "used": True,
    }  # fmt: skip
    return mapping.replace(solution=held).add_findings({"focal_prior": figures})


def _find_formal_sigma(solution: Solution, flags: np.ndarray, turns: StatedTurns | None) -> float:
    """Finds the relative standard deviation of the one focal length by errors that are stated."""
    try:
        (known,) = estimate_lens_sigmas(solution, flags, turns)
    except SolveError:
        return math.inf
    return float(known[find_focal_params(solution.cameras[0])[0]]) / find_focal(solution)
