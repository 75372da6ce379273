"""Tolerances of compaction."""

# relative L2 of blend weights and their sum: float sums over some thousand pixels; worst 1.3e-7
COMPACT_WEIGHTS = 2.6e-7
COMPACT_SCORE = 1e-6  # relative: one formula in two orders of rounding
# Relative: double along rays that are stored as floats; worst 2.9e-9 and 1e-10
COMPACT_HITS = 6e-9
COMPACT_WINNER_POINT = 5e-7  # world units of about 1: a point in float; worst 2.7e-7
COMPACT_WINNER = 1e-12  # two weights as equal as double can tell; worst 0
# Relative: as above, squared derivatives; worst 4.0e-8
COMPACT_FISHER = 8e-8
COMPACT_LOG_DET = 1e-6  # of a determinant of 6 x 6 numbers as good as that; worst 4.8e-7
# Image rms after merging pairs of equal Gaussians back; some merge with neighbours; worst 0.016
COMPACT_DUPLICATES = 0.032
COMPACT_INVARIANCE_DB = 1e-3  # what is promised; worst 8e-6
COMPACT_BYTES = 210  # peak, of each Gaussian with the arrays given (56); worst 105
SUPPORT = 1e-6  # of the largest, and of the sum: float32 against double; worst 9e-8
FLOATERS_LEFT = 0.068  # share of the squared error of planted ones; worst 0.034
FLOATERS_WRONG = 0.005  # share of what is there; worst 0
CONFIDENCE_SUMS = 1e-5  # relative: float sums of some thousand pixels; worst 3e-7
CONFIDENCE_QUANTILES = 0.03  # of 15 000 draws, at most five standard deviations
CONFIDENCE_MOVED = 1e-5  # of colours: means rounded about another origin
