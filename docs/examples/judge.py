"""Compares renders with held-out photographs."""

import numpy as np

import gsut

scene, gaussians = gsut.load_dataset("DATA"), gsut.load_gaussians("RUN/scene.ply")
figures = gsut.evaluate(gaussians, scene, scene.test_indices)
print(figures["psnr"], figures["ssim"])
index = scene.test_indices[0]
image = gsut.render(gaussians, scene.camera(index), scene.views[index].motion).image
photograph = scene.image(index).astype(np.float32) / 255
print(gsut.psnr(np.clip(image, 0, 1), photograph, scene.mask(index)))
