"""Decides which lens to take, and how far from its axis it can be trusted."""

from calib.trust.choose import choose_lens, solve_camera
from calib.trust.cross_validation import HeldOut
from calib.trust.halves import (
    AGREEMENT_DEGREES,
    Halves,
    compare_lenses,
    find_agreement_angle,
    solve_halves,
)
from calib.trust.second_lens import (
    SecondLens,
    cut_where_lenses_differ,
    refuse_narrow_field,
    solve_others,
)
from calib.trust.trust import TRUSTED_SIGMA_PX, Trust, judge, trace_trusted_outline
from calib.trust.uncertainty import UNKNOWN, map_uncertainty_if_possible, spread_pixels

__all__ = [
    "AGREEMENT_DEGREES",
    "TRUSTED_SIGMA_PX",
    "UNKNOWN",
    "Halves",
    "HeldOut",
    "SecondLens",
    "Trust",
    "choose_lens",
    "compare_lenses",
    "cut_where_lenses_differ",
    "find_agreement_angle",
    "judge",
    "map_uncertainty_if_possible",
    "refuse_narrow_field",
    "solve_camera",
    "solve_halves",
    "solve_others",
    "spread_pixels",
    "trace_trusted_outline",
]
