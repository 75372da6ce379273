"""Lenses estimated from photographs: candidates, search, refinement and what remains in doubt."""

from gsut.sfm.lens.candidates import guess_lenses
from gsut.sfm.lens.covariance import by_turn, free_columns, residual_spread, without_points
from gsut.sfm.lens.doubt import FOCAL_LIMITS, TURNED, LensDoubt, lens_doubt
from gsut.sfm.lens.refinement import RefinedLens, refine_lens
from gsut.sfm.lens.start import compare_lens
from gsut.sfm.lens.zooms import Zoom, find_zooms, search_zooms, zooms_notes

__all__ = [
    "FOCAL_LIMITS",
    "TURNED",
    "LensDoubt",
    "RefinedLens",
    "Zoom",
    "by_turn",
    "compare_lens",
    "find_zooms",
    "free_columns",
    "guess_lenses",
    "lens_doubt",
    "refine_lens",
    "residual_spread",
    "search_zooms",
    "without_points",
    "zooms_notes",
]
