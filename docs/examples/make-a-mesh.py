"""Extracts a mesh of what the training views see."""

import gsut

scene, gaussians = gsut.load_dataset("DATA"), gsut.load_gaussians("RUN/scene.ply")
mesh = gsut.extract_mesh(gaussians, scene, gsut.surface.MeshOptions(voxel=0.1))
gsut.save_mesh("mesh.ply", mesh)
print(mesh)
