"""gsut.torch and gsut in other people's programs."""

TORCH_HARMONICS = 1e-13  # one recurrence against another, in double; worst 9e-16
TORCH_GSPLAT = 1e-6  # relative L2, float32 against float32; worst 9e-8
TORCH_RELOCATION = 1e-6  # sum over a line for its integral, float32 opacities; worst 1e-7
TORCH_SHADING = 1e-5  # harmonics shaded by torch for those of the engine, float32; worst 1e-6
JAX_SLOPE = 1e-5  # relative L2: JAX rounds the image's slopes in another order; worst 2e-7
NERFSTUDIO_RAYS = 1e-4  # float32 against double, its lens inverted in a few steps
