"""Tolerances of rigs: two cameras 0.3 apart, 10 frames of a walk 2 wide, points 3 to 7 away."""

RIG_EXACT = 8e-14  # units and degrees, exact tracks, no scale taken out, 3 seeds; worst 3.8e-14
RIG_UNITS = 0.007  # centres, 0.2 px of noise, the first pose laid on truth, 3 seeds; worst 0.0035
RIG_DEGREES = 0.1  # the same; worst 0.050, of an image with six points and its mate
RIG_FEW_UNITS = 0.011  # a moment of ten points in each camera, 3 seeds; worst 0.0053
RIG_FEW_DEGREES = 0.1  # the same; worst 0.048
RIG_HELD = 5.2e-15  # poses of a moment's cameras to each other; worst 2.6e-15
RIG_DEMO_SCALE_PERCENT = 0.048  # six moments of two fisheyes at 200 x 200; worst 0.024
RIG_DEMO_METRES = 0.0056  # centres there, no scale taken out
RIG_SCALE_SIGMA = (
    2.0  # errors of the scale over their standard error, rms of 12 runs, either way; found 1.33
)
RIG_SIZE = 8.9e-16  # of a refined rig, relative; worst 4.5e-16
RIG_REFINED_DEGREES = 0.021  # left of 0.5, 3 seeds; worst 0.0107
RIG_REFINED_SHARE = 0.0035  # of the baseline, left of 0.01, 3 seeds; worst 0.0017
RIG_FOUND_DEGREES = 0.11  # a rig and its two lenses found from 8 frames, 3 seeds; worst 0.055
RIG_FOUND_LENS_PX = 0.5  # focal lengths and centres of these lenses; worst 0.25
RIG_CENTER_PX = 0.042  # principal points of two estimated lenses on a refined rig; worst 0.0207
RIG_ROLLING_EXACT = (
    1e-9  # centres of rigs with rolling shutters from exact tracks, 4 kinds; worst 5e-10, since
    # the start takes features for 0.15 px off
)
RIG_ROLLING_ENDS = (
    1.5e-4  # their centres at both ends of a readout, whose arc is a line; worst 7.3e-5
)
RIG_READOUT = 0.036  # of a video of two fisheyes, found with its rig, 3 orders; worst 0.018
RIG_OPEN_SHIFT = 0.06  # of the baseline: a refined place, its height open, no overlap; worst 0.030
RIG_TURN_CHI_SQUARE = 3.0  # squared error of a mount's turn a degree of freedom, 6 runs; found 1.02
