"""Tolerances of Adam, densification and least squares."""

ADAM_RELATIVE = 7e-7  # of the summed updates: float32 against float64 arithmetic; worst 3.4e-7
REGULARIZER = 1.7e-7  # float32 of gradient plus regulariser; worst 8.6e-8
REGULARIZER_SCALES = 2.4e-7  # relative: float32 exponential and its factor; worst 1.2e-7
REGULARIZER_OPACITIES = 4.3e-8  # absolute, times rows: float32 opacities; worst 2.2e-8
MCMC_MEAN = 1.7e-5  # float32 means of up to 20 000 copies, averaged in float32; worst 8.4e-6
MCMC_SHARES = 0.03  # statistical: shares of 1600 draws; worst 0.019
MCMC_MOMENT = 0.01  # statistical, of the trace: mixture of 4000 splits; worst of 9 runs 0.0046
NOISE_MOMENT = 0.023  # statistical, of the trace: 20 000 draws; worst of 3 seeds 0.012
LEAST_SQUARES = 1e-15  # double at a minimum of cost 0; worst of 20 seeds 4.4e-16
