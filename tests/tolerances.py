"""Every tolerance of the Python tests: value, reason, worst seen. One section a folder."""

# --- loss
# PSNR and SSIM in double, sums of 1e4 terms in another order than OpenCV's; worst 4e-14
METRIC_ROUNDING = 1e-12
# float32 kernels against the double reference; the bounds of tests/cpp/loss_test.cpp, where the
# worst over all instruction sets and cases is 2.7e-7 and 1.04e-6
LOSS_RELATIVE = 5e-7
LOSS_GRADIENT_RELATIVE = 2e-6
# dB; rounding alone: mean squared error (condition 10 x eps)^2 or less; worst 317
EXACT_PSNR = 290.0

# --- demo_scene
DEMO_ROTATION = 1e-15  # a rotation times its transpose in double, a few eps; worst 3.4e-16
DEMO_POINT_MEDIAN = 0.016  # metres; perturbed by sigma 1 cm in each axis; worst 0.0082
DEMO_POINT_FAR = 0.08  # metres, 99 % of the points: grazing rays stretch it; worst 0.043
DEMO_POINT_COLOR_SHARE = 0.99  # of points within a pixel of their colour; worst 1
DEMO_DEPTH = 6e-4  # metres: half a stored millimetre and float32 rays; worst 5.0e-4
# grey levels of 255, median: 64-pixel images of finer textures; worst 9.7, unrelated pixels 38
DEMO_VIEW_GREY_LEVELS = 12.0
DEMO_SURFACE = 1e-5  # metres; squares of 4 m in float32, grazing rays; worst 4.3e-6
