"""Tolerances of benchmarks."""

# The scalar float baseline against the double reference, where the rule does not jump; worst
# 3.01e-7 and, of the quaternions, 1.02e-5
SCALAR_IMAGE_RMS = 6e-7
SCALAR_GRADIENT_RELATIVE = 2e-5
BENCH_ROUNDING = 1e-12  # sums in double of numbers up to 100, in another order
AUC_ROUNDING = 1e-4  # relative, of a rotation given by seven digits; worst 3e-7
