"""Renders a scene through a lens of your choice, and along a path."""

import numpy as np

import gsut

scene, gaussians = gsut.load_dataset("DATA"), gsut.load_gaussians("RUN/scene.ply")
camera = gsut.load_camera("fisheye.yaml")
rendered = gsut.render(gaussians, camera, scene.views[0].camera_from_world)
gsut.write_png("view.png", gsut.rendering.to_uint8(rendered.image))
surface = gsut.render_surface(rendered)
print(np.nanmedian(surface.median), "along the rays")
exact = gsut.render(gaussians, camera, scene.views[0].camera_from_world, dtype="float64")
assert np.abs(rendered.image - exact.image).max() < 1e-3
