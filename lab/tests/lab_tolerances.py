"""Tolerances of the laboratory's tests: value, reason, worst observed."""

PROVING_DEPTH = 0.014  # relative, median; pixels of half a degree at edges; worst 0.0071
PROVING_AREA = 1e-6  # of exact poses, whose angles round to 1e-8 degrees; worst 3e-8
PROVING_SLOW_ROLLING = 0.8  # least AUC at 5 degrees of a slow rolling shutter; worst 0.92
PROVING_SAME_VIEW = 0.9  # least share of right detail of a view from the same place; worst 1.0
PROVING_SAME_LENS = 1e-6  # pixels between a lens and itself turned; worst 1e-10
PROVING_GAIN = 0.01  # stops, of a picture that is doubled; worst 0.000
BENCH_SPLIT_SHARE = 0.05  # of the volume of a tenth: random scales of 2000 Gaussians; worst 0.01
