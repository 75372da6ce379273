"""Tolerances of loss and metrics."""

# PSNR and SSIM in double, sums of 1e4 terms in another order than OpenCV's; worst 4e-14
METRIC_ROUNDING = 1e-12
# float32 kernels against the double reference; the bounds of tests/cpp/loss_test.cpp, where the
# worst over all instruction sets and cases is 2.7e-7 and 1.04e-6
LOSS_RELATIVE = 5e-7
LOSS_GRADIENT_RELATIVE = 2e-6
# dB; rounding alone: mean squared error (condition 10 x eps)^2 or less; worst 317
EXACT_PSNR = 290.0
