"""Corrects the first estimate of a readout time by adjusting poses with it, again and again."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gsut.least_squares import ROUNDS
from gsut.sfm.mapping import Mapping
from gsut.sfm.shutter.readout import FlowReadout, estimate_readout_by_flow
from gsut.sfm.solution import Solution

LONGEST_READOUT = 0.05  # seconds: slower sensors are not used for video
USUALLY_SHORT = 2.0  # factor by which the first estimate is usually too short
_SETTLED = 0.03  # relative size of a correction that ends them
_LEAST_SLOPE = 0.25  # share of what is missing that a correction is taken to reach at least


def correct_readout(
    mapping: Mapping,
    velocities: tuple[np.ndarray, np.ndarray],
    found: FlowReadout,
    adjust: Callable[[float], Solution],
    lens_free: np.ndarray | None,
) -> FlowReadout | None:
    """Corrects the readout time until the residuals favour no other one.

    Poses without a rolling shutter have lost the observations that speak most for one: each
    correction is too small, by a share that the last two show (the secant method).

    Args:
        velocities: rates and their covariances, see `estimate_rates`.
        found: a first time.
        adjust: returns the solution with a readout time, whose velocities are the rates' exactly.
        lens_free: see `estimate_readout_by_flow`.

    Returns:
        None where there is no such time.
    """
    rates, spread = velocities
    time, slope, before = found.time, 1 / USUALLY_SHORT, None
    for number in range(ROUNDS):
        text = f"lines read in {1000 * time:.1f} ms?"
        mapping.log.show_share("shutter", 0.5 * number / ROUNDS, text)
        moved = adjust(time)
        more = estimate_readout_by_flow(moved, rates, spread, moved.measure_line_times(), lens_free)
        if more is None:
            break
        own, found = more.time, more
        if before is not None and abs(time - before[0]) > _SETTLED * time:
            slope = float(np.clip((before[1] - own) / (time - before[0]), _LEAST_SLOPE, 1.0))
        before = time, own
        time += own / slope
        if abs(own / slope) < _SETTLED * time or not 0 < time < LONGEST_READOUT:
            break
    # The standard deviation is too small by the same share as a correction.
    time /= found.reliability
    if not 0 < time < LONGEST_READOUT:
        return None
    return FlowReadout(time, found.sigma / (slope * found.reliability), found.reliability)
