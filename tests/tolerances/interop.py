"""gsut.torch and gsut in other people's programs."""

TORCH_HARMONICS = 1e-14  # one recurrence against another, in double; worst 3.4e-16
TORCH_GSPLAT = 1e-6  # relative L2, float32 against float32; worst 2.3e-7
TORCH_RELOCATION = 1e-7  # sum over a line for its integral, float32 opacities; worst 3.8e-9
TORCH_SHADING = 1e-6  # harmonics shaded by torch for those of the engine, float32; worst 6e-8
JAX_SLOPE = 1e-5  # relative L2: JAX rounds the image's slopes in another order; worst 1.8e-6
