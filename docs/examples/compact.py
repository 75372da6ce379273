"""Halves the number of Gaussians with the least loss in the training views."""

import gsut

scene, gaussians = gsut.load_dataset("DATA"), gsut.load_gaussians("RUN/scene.ply")
views = gsut.edit.list_seen_views(scene, scene.train_indices)
small = gsut.compact(gaussians, keep=0.5, views=views).gaussians
assert abs(len(small) - 0.5 * len(gaussians)) <= 1
