"""Tolerances of tests/python/blocks."""

MOST_OF_A_SHARE = 1.02  # of a block's share of the work: points are not split; worst 1.003
SHARES_SUM = 1e-5  # blocks' shares of a pixel against its alpha: float32 sums; worst 7e-7
