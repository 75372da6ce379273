"""Tolerances of layouts: poses after a way through text files and interpolation."""

LAYOUT_POSE = 1e-12  # 17 digits in the files, a few products of matrices of size 5; worst 4e-15
LAYOUT_INTERPOLATED = 1e-12  # uniform motion between two poses is met by interpolation; worst 3e-15
# The engineer's way: the hall in 96 pixels, body poses 0.5 ms early or late.
ENGINEER_CENTRE = 1e-3  # metres: 0.5 ms of a speed that changes by < 2 m/s; worst 1.4e-4
ENGINEER_DEGREES = 0.05  # 0.5 ms of a turn that changes by < 100 degrees a second; worst 0.018
ENGINEER_PSNR = 31.0  # dB on the held-out pictures; found 34.3
ENGINEER_COVERED = 0.95  # share of pixels with a surface; found 0.995
ENGINEER_DEPTH = 0.04  # median error of distances, relative; found 0.023
ENGINEER_UTM = 5e-8  # metres: a dozen units (9e-10) in the last place of 5.4e6; worst 1.3e-8
