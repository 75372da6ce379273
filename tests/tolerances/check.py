"""Tolerances of the checks before training."""

BODY_TURN_DEGREES = 0.7  # images of 160 pixels, the last step is 0.3 degrees; worst 0.36
READOUT_FRAMES = 0.002  # matches with 0.2 px of noise; velocities are differences; worst 4.4e-4
