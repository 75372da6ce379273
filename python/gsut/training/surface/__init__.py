"""The terms that `--surface` adds to the loss, and the distances that they may use."""

from gsut.training.surface.known_depth import check_maps
from gsut.training.surface.surface_terms import SurfaceTerms
