"""Crops a scene to a box and merges it with a moved copy of itself."""

import gsut
import numpy as np

gaussians = gsut.load_gaussians("RUN/scene.ply")
inside = gsut.edit.is_inside_box(gaussians, [-1, -1, 0], [1, 1, 2])
cropped = gaussians[inside]
world_from_copy = np.eye(4)
world_from_copy[0, 3] = 3.0  # along x, in the scene's unit
both = gsut.edit.merge_gaussians([cropped, gsut.edit.transform_gaussians(cropped, world_from_copy)])
assert len(both) == 2 * len(cropped)
