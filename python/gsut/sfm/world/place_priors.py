"""Adjusts poses, points and lens once more near the places that GPS states, where images allow it.

Straight flights leave long waves open: a plain becomes a dome, and no picture shows it. Places of
the cameras show it, so they enter the adjustment with their own errors as weights.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from gsut._core import SolveError
from gsut.data.poses import find_centers
from gsut.judge import KEPT, SURE
from gsut.judge.checks import SHAKY
from gsut.lens import find_focal_params
from gsut.sfm.mapping import Mapping
from gsut.sfm.solution import Adjustment, LensFlags, ReadoutMotion, Solution, StatedPlaces

# Vertical over horizontal error of GPS: satellites are above the receiver only.
_VERTICAL = 2.0
# Metres below which EXIF's degrees are not written.
_RESOLUTION = 0.1
# Unknowns of the similarity along the ground: scale, turn and shift.
_FITTED = 4


# (mapping, solution, places, flags of lenses) -> solution near these places.
Adjust = Callable[[Mapping, Solution, StatedPlaces, LensFlags], Solution]


def adjust_near_places(mapping: Mapping, places: np.ndarray, adjust_rig: Adjust) -> Mapping:
    """Adjusts the solution near stated places; it stays as it is where images contradict them.

    Args:
        mapping: with a solution in the world of the places.
        places: (N, 3) east, down, north in metres; NaN: not known, or far off.
        adjust_rig: adjusts the images of a rig.

    Returns:
        The run with the solution, and with "in_adjustment" and "sigma_m" of the figures of GPS.
    """
    solution, earth = mapping.solved, mapping.found.figures["earth"]
    off = find_centers(solution.camera_from_world) - places
    known = solution.registered & np.isfinite(off).all(axis=1)
    ground = float((off[known][:, [0, 2]] ** 2).sum())
    freedom = 2 * np.count_nonzero(known) - _FITTED
    sigma = max(math.sqrt(ground / freedom), _RESOLUTION)
    stated = StatedPlaces(
        np.where(known[:, None], places, np.nan), sigma * np.array([1.0, _VERTICAL, 1.0])
    )
    before = np.abs(off[known] / stated.sigma)

    def adjust(flags: LensFlags) -> Solution:
        if mapping.found.rig is not None:
            return adjust_rig(mapping, solution, stated, flags)
        return adjust_images(mapping, solution, flags, places=stated)

    held = try_adjustment(mapping, solution, adjust)
    if held is not None:
        after = find_centers(held.camera_from_world) - places
        own = held.registered & known
        far = np.abs(after[own] / stated.sigma).max(axis=1)
        held = held if float(np.median(far)) <= SURE else None
    gps = {**earth["gps"], "sigma_m": sigma, "in_adjustment": held is not None}
    mapping = mapping.add_findings({"earth": {**earth, "gps": gps}})
    if held is None:
        mapping.log.note(
            "GPS stays out of the adjustment: the images contradict its places, whose heights are "
            f"{float(np.median(np.abs(off[known][:, 1]))):.1f} m off the cameras' (median); either "
            "its altitudes are wrong, or the lens is"
        )
        return mapping
    heights = float(np.median(np.abs(after[known][:, 1])))
    mapping.log.note(
        f"the places of GPS took part in the adjustment (to {sigma:.1f} m along the ground, "
        f"{_VERTICAL * sigma:.1f} m in height): heights are off by {heights:.2f} m "
        f"(median), before by {float(np.median(before[:, 1]) * stated.sigma[1]):.2f} m"
    )
    return mapping.replace(solution=held)


def adjust_images(
    mapping: Mapping, solution: Solution, lens_free: LensFlags, **stated: Any
) -> Solution:
    """Adjusts images that have a pose each, and move during their readouts as before.

    Args:
        stated: `places` or `points`, see `Adjustment`.

    Raises:
        SolveError: too few points agree with the poses.
    """
    motion = ReadoutMotion.follow(solution)
    adjustment = Adjustment(lens_free, extend=True, motion=motion, turns=mapping.turns, **stated)
    return mapping.adjust(adjustment, solution, stage="mapping")


def try_adjustment(
    mapping: Mapping, solution: Solution, adjust: Callable[[LensFlags], Solution]
) -> Solution | None:
    """Adjusts near what is stated; None where that fails or the images contradict it.

    Args:
        adjust: takes the flags of lenses.
    """
    flags = mapping.lens_free
    prior = mapping.found.figures.get("focal_prior")
    if isinstance(flags, np.ndarray) and prior is not None and prior["used"]:
        flags = flags.copy()
        flags[find_focal_params(solution.cameras[0])] = 0
    try:
        held = adjust(flags)
    except SolveError:
        return None
    agrees = (
        held.num_registered == solution.num_registered
        and len(held.points) >= KEPT * len(solution.points)
        and held.median <= SHAKY * solution.median
    )
    return held if agrees else None
