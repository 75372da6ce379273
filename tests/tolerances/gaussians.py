"""Tolerances of parameters and seeding."""

HARMONICS = 1.2e-14  # scipy's own arccos and cancellation included, values up to 2.9; worst 6.0e-15
FLOAT32 = 1.2e-7  # one rounding to float32, 2^-23; worst 1.1e-7
ACTIVATED_FLOAT32 = 5e-7  # exp or sigmoid of a float32 parameter up to 4; worst 2.4e-7
VIEW_DISTANCE = 1e-14  # a point to world axes and back in double, coordinates below 10
VIEW_MEDIAN = 0.1  # statistical: median of 5000 distances, more than 5 standard errors

GROUND_DEGREES = 0.1  # 1500 Gaussians 0.01 about a floor of 8 x 8; worst 0.03
GROUND_LEVEL = 0.01  # of the same; worst 0.004
POSE_ROUNDING = 1e-14  # products of a few rotations in double; worst 6e-16
# A power series of 40 terms of a matrix of norm up to 5, e^5 eps; worst 9e-14
POSE_SERIES = 1e-12
