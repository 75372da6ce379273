"""Looks up a camera, converts a lens to another model, and measures the error."""

import gsut

print(gsut.lens.find_lenses("hero9 max wide")[:1])
camera = gsut.load_camera("fisheye.yaml")
converted = gsut.lens.convert_camera(camera, "opencv8")
print(converted)  # errors by field angle
gsut.save_camera(converted.camera, "opencv8.yaml")
