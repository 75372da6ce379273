"""Every tolerance of the Python tests: value, reason, worst seen. One section a folder."""

# --- gaussians, seeding ---------------------------------------------------------------------------
HARMONICS = 2e-15  # a dozen operations in double on values up to 2.9; worst 1.3e-15
NEIGHBOR_DISTANCE = 1e-14  # square root of a sum of three squares, mean of three; worst 1e-15
FLOAT32 = 1.2e-7  # relative: one rounding to float32, 2^-23

# --- optimize -------------------------------------------------------------------------------------
ADAM_RELATIVE = 4e-6  # of the summed updates: float32 against float64 arithmetic; worst 3e-7
MCMC_SAME_PLACE = 1e-12  # double against exact rational sums; cancellation grows to 1e4 eps
MCMC_PROFILE_SAME_PLACE = (
    0.03  # opacity along a line through the centre is kept; method, worst 0.02
)
MCMC_MOMENT = 0.02  # statistical: mixture covariance over 4000 splits, 3 standard errors
MCMC_THICKNESS = 0.02  # second order in an opacity of 0.05; worst 0.006
NOISE_MOMENT = 0.03  # statistical: covariance of 20 000 draws, 3 standard errors
# --- loss
# PSNR and SSIM in double, sums of 1e4 terms in another order than OpenCV's; worst 4e-14
METRIC_ROUNDING = 1e-12
# float32 kernels against the double reference; the bounds of tests/cpp/loss_test.cpp, where the
# worst over all instruction sets and cases is 2.7e-7 and 1.04e-6
LOSS_RELATIVE = 5e-7
LOSS_GRADIENT_RELATIVE = 2e-6
# dB; rounding alone: mean squared error (condition 10 x eps)^2 or less; worst 317
EXACT_PSNR = 290.0

# --- runs, evaluation and camera paths
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
# --- data: dataset readers ---------------------------------------------------------------------
DATA_ROUNDING = 1e-14  # one multiplication or division in double: a few eps
DATA_POSE = 1e-12  # poses of size 4 through a quaternion or an SVD in double: 100 eps; worst 2e-15
DATA_PLY_POSITION = 2e-7  # a PLY file stores float32; coordinates up to 1.5 round by 6e-8
DATA_UTM_POSITION = 2e-9  # coordinates of 5.4e6 in double have a spacing of 9.3e-10
DATA_EIGHT_BIT = 0.5  # rounding of a mean to 8 bits; worst 0.5
DATA_TEXTURE_STEP = 16  # grey levels between neighbouring pixels of the small plane; worst 13

# --- calib: boards to lenses ----------------------------------------------------------------------
# RMS of corners of small curved squares (9 to 20 px) drawn with 2 x 2 rays a pixel; worst 0.23
CALIB_DRAWN_CORNER_PX = 0.4
CALIB_DRAWN_OFFSET_PX = 0.1  # their mean: half a pixel would be a mistaken convention
CALIB_SAME_CORNER_PX = 0.02  # cornerSubPix of the same picture turned: its stop is 1e-3 px
CALIB_RIGID = 1e-12  # rotation vectors through matrices up to half a turn: 1e4 eps near pi
CALIB_EXACT_PARAMS = 1e-4  # pixels and coefficients: OpenCV stops at a relative change of 1e-10
CALIB_WRITTEN = 1e-12  # 17 digits, and half a pixel added and taken off
CALIB_NOISE_RELATIVE = 0.06  # of a noise found from 700 corners: 3 standard deviations
CALIB_COVERAGE_LEAST = 0.8  # of 95 % in 8 solves; 3 standard deviations of correlated trials
CALIB_SPLINE_LIKE_PX = 0.02  # a spline with knots 9 degrees apart for a fisheye; method
CALIB_RIG_DEGREES = 0.1  # of a rig from 12 boards with 0.02 px of noise; 0.32 with 0.1 px
CALIB_RIG_METRES = 0.0005  # the same
CALIB_SIGMA_RATIO = (0.5, 2.0)  # mrcal's uncertainty over ours; other unknowns, other priors
# RMS (2-D, px) of the real left fisheye, as found before gsut with each solver; found 0.1773,
# 0.1685, 0.1496
CALIB_REAL_FISHEYE_PX = 0.180
CALIB_REAL_OPENCV8_PX = 0.172
CALIB_REAL_SPLINED_PX = 0.152
CALIB_DRAWN_LENS_PX = 0.6  # focal lengths and centre from ten drawn boards; worst 0.31
CALIB_WIDE_PX = 0.25  # focal lengths and centre from 24 boards with 0.05 px of noise; found 0.11
