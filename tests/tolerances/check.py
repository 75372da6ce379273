"""Tolerances of the checks before training."""

BODY_TURN_DEGREES = 2.0  # pixels of 160 a side: the last step is 0.3 degrees; worst 0.5
