"""Tolerances of frames chosen from videos."""

CAPTURE_FLOW_SPEED = 0.06  # of the fastest: the fifth order that is left out, 0.058; worst 0.051
TURNS_CLOCK_SECONDS = 1e-9  # linear in doubles; worst 1e-15
TURNS_AXES = 1e-6  # of values of 0.3 by a matrix in float; worst 1e-8
# Quaternions are stored to 1 / 32767, over a frame of a thirtieth of a second; worst 1.4e-3.
TURNS_OF_ORIENTATIONS = 2.8e-3
