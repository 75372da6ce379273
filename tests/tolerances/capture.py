"""Tolerances of frames chosen from videos."""

CAPTURE_FLOW_SPEED = 0.06  # of the fastest: the fifth order that is left out, 0.058; worst 0.051
FRAME_SECONDS = 1e-6  # s, of the microseconds of a film's duration; worst 1e-15
