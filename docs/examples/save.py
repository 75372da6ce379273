"""Writes and reads scene files; the suffix selects the [format](../formats.md)."""

import gsut

gaussians = gsut.load_gaussians("RUN/scene.ply")
gsut.save_gaussians("copy.spz", gaussians)
print(gsut.load_gaussians("copy.spz"))
