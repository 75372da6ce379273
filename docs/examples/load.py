"""Reads a dataset, checks it, and converts it to another layout."""

import gsut

scene = gsut.load_dataset("DATA", test_every=4)
print(scene, scene.views[0])
errors = [f for f in gsut.doctor(scene, progress=False) if f.severity == "error"]
assert not errors, errors[0]
camera = gsut.load_camera("fisheye.yaml")
rays, valid = camera.rays()  # (H, W, 3) unit vectors, (H, W) bool
gsut.convert_dataset("DATA", "DATA-colmap", to="colmap")
