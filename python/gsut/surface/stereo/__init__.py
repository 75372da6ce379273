"""Distances that photographs show, by comparing them through their lenses and shutters."""

from gsut.surface.stereo.depth import find_depth_maps
from gsut.surface.stereo.points import find_points_by_stereo, measure_coverage, sample_distances
from gsut.surface.stereo.refine import DepthRefiner
