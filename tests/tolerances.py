"""Every tolerance of the Python tests: value, reason, worst seen. One section a folder."""

# Runs, evaluation and camera paths.
# PSNR of images that differ by 0.1 everywhere: the float32 rounding of 0.1 and of the colours.
PSNR_OF_CONSTANT_ERROR_DB = 1e-4  # worst seen 1e-6
# Orthonormality and position of poses made by a 3x3 SVD in double: tens of eps.
RIGID_POSE = 1e-12  # worst seen 3e-15
# Poses whose translation was moved by 112 units and back.
POSE_FAR_AWAY = 1e-11  # worst seen 6e-14
# A cubic through 9 keys over 4 radians of a circle of radius 3 bulges by about r h^4 / 384.
PATH_OFF_THE_CIRCLE = 0.02  # worst seen 0.008
# Change of velocity between two of 2000 frames over the mean speed; a kink at a key gives 0.1.
PATH_CHANGE_OF_SPEED = 0.02  # worst seen 0.008
# --- loss
# PSNR and SSIM in double, sums of 1e4 terms in another order than OpenCV's; worst 4e-14
METRIC_ROUNDING = 1e-12
# float32 kernels against the double reference; the bounds of tests/cpp/loss_test.cpp, where the
# worst over all instruction sets and cases is 2.7e-7 and 1.04e-6
LOSS_RELATIVE = 5e-7
LOSS_GRADIENT_RELATIVE = 2e-6
# dB; rounding alone: mean squared error (condition 10 x eps)^2 or less; worst 317
EXACT_PSNR = 290.0
