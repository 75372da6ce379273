"""Tolerances of layouts: poses after a way through text files and interpolation."""

LAYOUT_POSE = 1e-12  # 17 digits in the files, a few products of matrices of size 5; worst 4e-15
LAYOUT_INTERPOLATED = 1e-12  # uniform motion between two poses is met by interpolation; worst 3e-15
# The engineer's way: the hall in 96 pixels, body poses 0.5 ms early or late.
ENGINEER_UTM = 5e-8  # metres: a dozen units (9e-10) in the last place of 5.4e6; worst 1.3e-8
