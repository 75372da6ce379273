"""Every tolerance of the Python tests: value, reason, worst seen. One section a folder."""

# --- gaussians, seeding ---------------------------------------------------------------------------
HARMONICS = 1.2e-14  # scipy's own arccos and cancellation included, values up to 2.9; worst 6.0e-15
NEIGHBOR_DISTANCE = 1e-15  # the same sums and roots as scipy in double; worst 0
FLOAT32 = 1.2e-7  # one rounding to float32, 2^-23; worst 1.1e-7
ACTIVATED_FLOAT32 = 5e-7  # exp or sigmoid of a float32 parameter up to 4; worst 2.4e-7
VIEW_DISTANCE = 1e-14  # a point to world axes and back in double, coordinates below 10
VIEW_MEDIAN = 0.1  # statistical: median of 5000 distances, more than 5 standard errors

# --- optimize -------------------------------------------------------------------------------------
ADAM_RELATIVE = 7e-7  # of the summed updates: float32 against float64 arithmetic; worst 3.4e-7
ADAM_FIRST_STEPS = 4.4e-7  # absolute: three float32 roundings of means; worst 2.2e-7
SCHEDULE = 1e-12  # a power in double
REGULARIZER = 1.7e-7  # float32 of gradient plus regulariser; worst 8.6e-8
MCMC_SAME_PLACE = 1e-12  # double against exact rational sums, which cancel; worst 2.5e-13
MCMC_PROFILE = 5e-7  # float32 parameters of up to 5 copies; worst 2.5e-7
MCMC_MEAN = 1.7e-5  # float32 means of up to 20 000 copies, averaged in float32; worst 8.4e-6
MCMC_SHARES = 0.03  # statistical: shares of 1600 draws; worst 0.019
MCMC_MOMENT = 0.01  # statistical, of the trace: mixture of 4000 splits; worst of 9 runs 0.0046
MCMC_THICKNESS = 0.01  # second order in an opacity of 0.05; worst 0.0048
NOISE_MOMENT = 0.023  # statistical, of the trace: 20 000 draws; worst of 3 seeds 0.012
