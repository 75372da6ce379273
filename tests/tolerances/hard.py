"""Tolerances of the hard cases."""

HARD_ALPHA = 1e-5  # one Gaussian, also around the camera, with or without a jump; worst 1.9e-6
# relative L2 of each array; needles and near Gaussians: 6e-8 of the distance over the scale, in
# sums that cancel; worst 6.9e-4
HARD_GRADIENT = 1e-3
# A gradient below this share of the scene's largest is compared with that share: of a round
# Gaussian, that to the quaternion is 0 but for rounding (4e-7 of the largest).
HARD_ZERO_GRADIENT = 1e-2
HARD_JUMPS_AN_IMAGE = 5  # pixels exactly on a discontinuity
HARD_WALL = 4e-6  # a wall of any width against its closed form; worst 1.8e-6
