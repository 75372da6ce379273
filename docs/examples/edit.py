"""Crops a scene to a box and merges it with a moved copy of itself."""

import numpy as np

import gsut

gaussians = gsut.load_gaussians("RUN/scene.ply")
inside = gsut.edit.is_inside_box(gaussians, [-1, -1, 0], [1, 1, 2])
cropped = gaussians[inside]
beside = gsut.edit.transform_gaussians(cropped, np.eye(3), translation=[3.0, 0, 0])  # in its unit
both = gsut.edit.merge_gaussians([cropped, beside])
assert len(both) == 2 * len(cropped)
