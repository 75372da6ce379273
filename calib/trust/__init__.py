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
