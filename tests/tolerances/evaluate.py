"""Tolerances of runs, evaluation and camera paths."""

# dB; images that differ by 0.1 everywhere: float32 rounding of 0.1 and of the colours; worst 8.1e-7
PSNR_OF_CONSTANT_ERROR_DB = 1.5e-6
# orthonormality and position of poses made by a 3x3 SVD in double: 45 eps; worst 2.7e-15
RIGID_POSE = 1e-14
# 45 eps x 112 units: poses whose translation was moved so far and back; worst 2.9e-14
POSE_FAR_AWAY = 1e-12
# a cubic through 9 keys on 4 radians of a circle of radius 3 leaves it by about
# 3 h^4 / 24 at h = 0.5, halved by the tangents; worst 5.6e-3
PATH_OFF_THE_CIRCLE = 0.01
# change of velocity between neighbours of 2000 frames over the mean speed; worst 0.0125 (a kink,
# as of straight lines between the keys, gives 0.68)
PATH_CHANGE_OF_SPEED = 0.025
SAME_FRAME_DB = 2e-3  # the same Gaussians in float32 about another zero
COMPACT_IN_PLACE_DB = 3.0  # a tenth of 600 Gaussians is gone, nothing is fine-tuned
LOCALIZED_ROUGHLY = 0.1  # units, in a scene of 150 steps, 48 x 48 pixels
REFINED_IN_PLACE = 0.3  # units that 150 steps on 48 x 48 pixels move exact poses
FORMATS_IN_PLACE = 0.02  # units; the coarsest format has 12 bits behind the point
SSIM_IN_FLOAT = 1e-6  # the loss' float kernel against double; worst 2.2e-8 of 480 x 480 pixels
FIGURE_ROUNDING = 1e-9  # dB; the same sums in another order; worst 4e-12
