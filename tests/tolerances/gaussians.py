"""Tolerances of parameters, seeding and the low-pass filter."""

HARMONICS = 1.2e-14  # scipy's own arccos and cancellation included, values up to 2.9; worst 6.0e-15
FLOAT32 = 1.2e-7  # one rounding to float32, 2^-23; worst 1.1e-7
ACTIVATED_FLOAT32 = 5e-7  # exp or sigmoid of a float32 parameter up to 4; worst 2.4e-7
VIEW_DISTANCE = 1e-14  # a point to world axes and back in double, coordinates below 10
VIEW_MEDIAN = 0.1  # statistical: median of 5000 distances, more than 5 standard errors

LOW_PASS_DOUBLE = 7e-15  # exponentials and logarithms in double, tens of eps; worst 3.5e-15
LOW_PASS_GRADIENT = 1e-5  # central differences of step 1e-6 in double, as bounds of the others
LOW_PASS_FLOAT = 1.2e-7  # L2, parameters rounded to float32: 1 ulp; worst 2.7e-8
LOW_PASS_RADIUS = 4e-5  # differences over 0.002 px against derivatives; worst 2.1e-5
LOW_PASS_GAIN_DB = 3.0  # dB at 1/16 of the size; observed 5.4
GROUND_DEGREES = 0.1  # 1500 Gaussians 0.01 about a floor of 8 x 8; worst 0.03
GROUND_LEVEL = 0.01  # of the same; worst 0.004
EDIT_UNDONE = 1e-5  # float32 of means to 20 units, twice rounded; worst observed 2e-6
