"""Tolerances of surfaces: depth, normals, fusion, meshes."""

# relative; alphas, and all of the expected distance, are float; worst 8.3e-5
SURFACE_MAPS = 2e-4
SURFACE_GRADIENTS = 1e-4  # relative L2: exact formulae along float rays
SURFACE_DISC = 2e-3  # a disc of a thousandth's thickness in place of a plane
