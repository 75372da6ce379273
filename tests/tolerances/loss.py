"""Tolerances of loss and metrics."""

# PSNR and SSIM in double, sums of 1e4 terms in another order than OpenCV's; worst 4e-14
METRIC_ROUNDING = 1e-12
# float32 kernels against the double reference where the mean runs over as many windows or more;
# worst over all instruction sets and cases 2.7e-7 and 1.04e-6
LOSS_RELATIVE = 5e-7
LOSS_GRADIENT_RELATIVE = 2e-6
LOSS_MANY_PIXELS = 30
# Derived, for a loss that hangs on a single window: variances are differences of numbers up to 0.25
# with a relative error of 2^-24 each, divided by at least C2 = 9e-4; worst 9.3e-6 (one pixel)
LOSS_SINGLE_WINDOW = 1.7e-5
# Central differences with this step of a loss with third derivatives up to 1e6; worst 1.2e-8
LOSS_STEP = 1e-5
LOSS_DIFFERENCES = 1e-7
# dB; rounding alone: mean squared error (condition 10 x eps)^2 or less; worst 317
EXACT_PSNR = 290.0
LIGHT_SUMS = 1e-6  # products in float, sums in double
# The photograph model on 48 x 48 pixels. Gains that drift slowly around a ring of ten views are the
# last that a scene unlearns: after 300 steps log-gains are off by 0.040 at worst
LIGHT_GAIN = 0.08
LIGHT_GAUGE = 1e-12  # rounding of exp and log
LIGHT_FALLOFF = 0.008  # of noise seen once by each of ten views; worst 0.0042
LIGHT_LEVEL = 1e-4  # rounding to float and of the gain; worst 1e-6
LIGHT_BRIGHTNESS = 0.066  # the rim shows other things than the centre; worst 0.033
LIGHT_GAINED_DB = 0.7  # mean of three seeds; observed 0.94
