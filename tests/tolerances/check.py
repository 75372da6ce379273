"""Tolerances of the checks before training."""

BODY_TURN_DEGREES = 0.7  # images of 160 pixels, the last step is 0.3 degrees; worst 0.36
