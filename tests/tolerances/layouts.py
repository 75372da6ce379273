"""Tolerances of layouts: poses after a way through text files and interpolation."""

LAYOUT_POSE = 1e-12  # 17 digits in the files, a few products of matrices of size 5; worst 4e-15
LAYOUT_INTERPOLATED = 1e-12  # uniform motion between two poses is met by interpolation; worst 3e-15
