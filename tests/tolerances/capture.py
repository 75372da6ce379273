"""Tolerances of frames chosen from videos."""

CAPTURE_FLOW_SPEED = 0.06  # of the fastest: the fifth order that is left out, 0.058; worst 0.051
