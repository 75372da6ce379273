"""Extracts a mesh of what the training views see."""

import gsut

scene, gaussians = gsut.load_dataset("DATA"), gsut.load_gaussians("RUN/scene.ply")
depths = gsut.surface.depth_maps(gaussians, scene, scene.train_indices)
mesh = gsut.surface.fuse_depth(depths)
gsut.save_mesh("mesh.ply", mesh)
print(mesh)
