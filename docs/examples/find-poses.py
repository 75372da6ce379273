"""Refines the pose of a photograph in a trained scene, and triangulates points of a dataset.

`gsut.find_poses("photos", "data")` finds the poses of a folder of photographs.
"""

import numpy as np

import gsut

run = gsut.load_run("RUN")
scene, index = run.scene, run.scene.test_indices[0]
start = gsut.exp_pose([0.01, 0, 0, 0, 0.002, 0]) @ scene.views[index].camera_from_world
camera, photograph, mask = scene.camera(index), scene.image(index), scene.mask(index)
found = gsut.poses.refine_pose(run.gaussians, camera, start, photograph, mask)
print(np.round(found.center, 3), found.center_std)  # world coordinates
