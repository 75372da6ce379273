"""Tolerances of stereo."""

FOUND_MEDIAN = 0.03  # of the distance, on pictures of 96 x 64 and 80 x 80 pixels; worst 0.022
FOUND_FAR, FOUND_SHARE = 0.1, 0.12  # of the distance; of the points, seen at a slant too
# Of the points, farther off than FOUND_FAR, where a photograph shows something else: points cover
# all that is seen, also where one other view alone agrees; worst 0.144.
FOUND_BY_CHANCE = 0.16
STEREO_MEDIAN = 0.04  # of the distance, on the same pictures
STEREO_SHARE = 0.3  # of the pixels that have a depth
STEREO_ROUNDING = 2e-4  # of correlations in float, of values up to 1
STEREO_NORMALS = 12.0  # degrees, in the median, on the same pictures; worst 8.0
NORMALS_ROUNDING = 0.02  # degrees, and of their length, from float distances
