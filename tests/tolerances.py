"""Every tolerance of the Python tests: value, reason, worst seen. One section a folder."""

# --- gaussians, seeding ---------------------------------------------------------------------------
HARMONICS = 2e-15  # a dozen operations in double on values up to 2.9; worst 1.3e-15
NEIGHBOR_DISTANCE = 1e-14  # square root of a sum of three squares, mean of three; worst 1e-15
FLOAT32 = 1.2e-7  # relative: one rounding to float32, 2^-23
ACTIVATED_FLOAT32 = 1e-6  # exp or sigmoid of a float32 parameter up to 8: 8 x 1.2e-7; worst 5e-7
VIEW_DISTANCE = 1e-9  # a point to world axes and back in double, coordinates below 10
VIEW_MEDIAN = 0.1  # statistical: median of 5000 distances, more than 5 standard errors

# --- optimize -------------------------------------------------------------------------------------
ADAM_RELATIVE = 4e-6  # of the summed updates: float32 against float64 arithmetic; worst 3e-7
ADAM_FIRST_STEPS = 1e-6  # three float32 roundings of means up to 4: 3 x 2.4e-7
SCHEDULE = 1e-12  # a power in double
REGULARIZER = 5e-7  # float32 of gradient + regulariser, both up to 3; worst 2.4e-7
MCMC_SAME_PLACE = 1e-12  # double against exact rational sums; cancellation grows to 1e4 eps
MCMC_PROFILE_SAME_PLACE = (
    0.03  # opacity along a line through the centre is kept; method, worst 0.02
)
MCMC_PEAK = 1e-5  # n float32 opacities multiplied
MCMC_MEAN = 1e-5  # float32 means of up to 20 000 copies, averaged in float32
MCMC_SHARES = 0.03  # statistical: shares of 1600 draws, 3 standard errors
MCMC_MOMENT = 0.02  # statistical: mixture covariance over 4000 splits, 3 standard errors
MCMC_THICKNESS = 0.02  # second order in an opacity of 0.05; worst 0.006
NOISE_MOMENT = 0.03  # statistical: covariance of 20 000 draws, 3 standard errors
