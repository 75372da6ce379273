"""Decides by evidence: which of two structures, or hypotheses, explains matches better."""

from gsut.judge.epipolar import (
    MOMENTS,
    SAME_DEGREES,
    TINY,
    compute_cross_products,
    measure_angular_errors,
    measure_pixels_per_radian,
)
from gsut.judge.hypotheses import Dataset, Hypothesis, Variant, find_best_variants
from gsut.judge.lens_errors import LENS_ERRORS
from gsut.judge.path_errors import PATH_ERRORS
from gsut.judge.preference import (
    KEPT,
    LEAST_NOISE,
    MEDIAN_DEVIATION,
    SURE,
    Matches,
    Preference,
    Structure,
    estimate_share,
    prefer,
    score_errors,
)
from gsut.judge.readings import READINGS, list_signed_permutations

# The likelier first: of those that explain the photographs alike, the first is named.
HYPOTHESES = (*READINGS, *LENS_ERRORS, *PATH_ERRORS)
