"""Tolerances of structure from motion."""

# Degrees, of 8 images of 500 points with 0.2 px of noise at 300 px a radian; worst 0.016
SFM_SYNTHETIC_DEGREES = 0.02
SFM_THIN_DEGREES = 0.065  # two halves joined by one pair and five points; worst 0.033
SFM_THIN_ATE_PERCENT = 0.073  # of the path, the same scene; worst 0.037
SFM_SYNTHETIC_ATE_PERCENT = 0.011  # of the path, the same scene; worst 0.0057
# Centres' error by adjustments that leave tracks out, over that by all tracks; worst 0.99
SFM_THINNED_ATE_RATIO = 1.2
# Noise of features of another kind over the first kind's, where 5 is right; 4.9 observed
SFM_OTHER_NOISE = (4.5, 5.5)
# Centres' error where each kind has its own weight, over that where all weigh alike; worst 0.82
SFM_OTHER_NOISE_ATE_RATIO = 0.95
SFM_FOCAL = 1.3e-4  # relative, of a lens found from 8 to 10 images, 0.1 px of noise; worst 6.8e-5
SFM_FEW_NOISY_FOCAL = 0.02  # relative, of a lens by 6 images, 0.7 px of noise; worst 0.0099
# Median, 12 images of sponza_fisheye, whose short path fixes the similarity badly; worst 0.089
SFM_SPONZA_DEGREES = 0.1
SFM_SPONZA_ATE_PERCENT = 0.04  # of their extent; worst 0.021
# A rolling walk of 10 images of 500 points, 0.1 px of noise, 3 seeds; worst 0.060 degrees, 0.0062 %
SFM_ROLLING_DEGREES = 0.12
SFM_ROLLING_ATE_PERCENT = 0.012
SCHUR_DENSE = 5e-12  # of sums of some hundred; least squares in another order; worst 2.8e-12
LINEAR_JACKKNIFE = 0.4  # relative difference of spreads by one step and by adjusting; worst 0.22
ONE_WINDOW = 1 + 1e-9  # sigma by one window over that of all images; worst 1 + 4e-13
SFM_RATE_DEGREES = 1.0  # a second, of 9: rates of frames from the flow
MARKER_CORNER_PX = 0.5  # corners of ray-traced markers of 50 pixels
CONTROL_CENTER = 0.02  # metres, of cameras 4 m off
CONTROL_LENGTH = 0.001  # relative, of a path by four control points
CONTROL_CHECK = 0.01  # metres, of check points that take no part
MARKER_FRAME = 0.01  # metres: cameras 2 m off and corners, in the frame of two markers
MARKER_LENGTH = 0.001  # relative, of a path by two markers
SFM_EARTH_METRES = 0.2  # beside 1.2 of the noise of GPS; worst 0.15
SFM_EARTH_SCALE = 0.01  # relative, with GPS of 0.1 m on a path of 60; worst of 40 seeds 0.0017
SFM_MEASURED_UP_DEGREES = 5.0  # 24 sensors' ups of 6 degrees; worst of 40 seeds 3.9
SFM_EARTH_HEIGHT = 0.8  # metres, over a path of 60
SFM_HELMET_DEGREES = 3.0  # turn in a readout, 14 views of helmet_distorted_rs; worst 1.64
SFM_COVARIANCE = 3.8  # mean normalised square of pose errors over 6, either way; worst 1.9
SIFT_BLOB_PIXELS = 0.06  # SIFT's place of a Gaussian blob; worst 0.031
# A lens refined from 8 images of 700 points with 0.2 px of noise: its errors in its own standard
# deviations (8 parameters, normal: beyond 4 once in 2000 draws)
REFINED_LENS_SIGMAS = 4.0
# Root mean square of such errors over 16 draws; statistical: k1 to k4 hang together, so that about
# 60 of the 128 are independent; found 1.11
REFINED_SIGMA_RATIO = (0.75, 1.3)
# Every lens: 300 points, 5 frames 256 pixels wide, 0.1 px of noise; opencv12 and 14 are the worst.
SFM_EVERY_LENS_ATE_PERCENT = 0.22  # of the path's extent; worst 0.11
SFM_EVERY_LENS_DEGREES = 0.65  # largest of an image; worst 0.325
SFM_EVERY_LENS_SCALE_PERCENT = 0.54  # of the lengths that a rig gives; worst 0.271
# An image 96 pixels wide of 800 Gaussians, in 8 bits; narrow lenses are the worst.
LOCALIZE_EVERY_LENS_DEGREES = 0.14  # worst 0.0708
LOCALIZE_EVERY_LENS_UNITS = 2.5e-3  # worst 1.27e-3
POINTS_COLOUR_LEVELS = 12.0  # of 255, median, points of sponza_fisheye by eight views; worst 0
POSITIONS_FIT = 1e-8  # metres, of coordinates of 5e6: a double steps by 1e-9 there; worst 1e-9
GEODETIC_METRES = 0.005  # metres at 111 m: the earth's curve is 1 mm there; worst 1.0e-3
SFM_READOUT_SHORT = 0.03  # share, a time from noisy flow with its reliability
SFM_TOLD_APART_ATE_PERCENT = 0.1  # one of two rooms alike; worst observed 0
SEVERAL_LENSES_FOCAL = 0.0018  # relative, of two cameras of 14 images each, 0.1 px; worst 0.00089
SEVERAL_LENSES_FEW_FOCAL = 0.012  # of two images, which leave higher coefficients at 0; worst 0.006
SEVERAL_LENSES_ATE_PERCENT = 0.11  # of the path, in the same scenes; worst 0.059
FOCAL_SPREADS = 2.0  # errors over their jackknife, root mean square, either way; worst 0.83
FOCAL_SIGMAS = 3.0  # standard deviations of a focal length that its error stays within; worst 0.84
HALVES_FACTOR = (
    2.0  # of the error of poses over the half difference of halves, both ways; worst 1.01
)
FOCAL_SIGMA_SHARED = (
    1.2  # least sigma with shared errors over that of the features alone; worst 1.8
)
LENS_EACH_FOCAL = 0.004  # relative, of images with a lens each, 0.1 px; worst 0.002
LEFT_OUT_TURN = 0.0028  # radians in a readout, of eight images with velocities; worst 0.0014
LEFT_OUT_ATE_PERCENT = 0.011  # of the path, one of eight images by few points; worst 0.0057
GPS_DOME_SHARE = 0.5  # of the dome that images leave, by places to 0.1 m; worst 0.29
GPS_ROLLING_DOME = 0.95  # the same as GPS_DOME_SHARE under a rolling shutter; worst 0.84
GPS_RATE = 0.15  # relative, of speeds during a readout that start 5 % off; worst 0.075
GPS_RIG_RIGID = 1e-9  # metres and parts of a turn, rounding at 200 m; worst 2e-13
GPS_RIG_SIZE = 0.01  # relative, by places to 0.1 m on a path of 100 m; worst 0.005
GPS_NOISY_DOME = 1.1  # the same, by places to 0.5 and 2 m; worst 0.98
CENTER_SIGMAS = 3.0  # a principal point's error in its standard deviations; worst 2.3
CENTER_OPEN = (
    0.25  # relative, of the prior's standard deviation where images say nothing; worst 0.18
)
CENTER_HELD_PX = 1e-4  # a principal point by a prior of 1e-8 px; worst 2e-7
LEARNED_MAPS = 1e-4  # outputs of the network, float32 in another order; worst 2.3e-5
LEARNED_FEATURES = 1e-5  # scores and descriptors of keypoints; worst 7e-7
LEARNED_COSINE = 0.999  # median, of descriptors in bytes with those of the network; worst 0.9997

# Of a gyroscope's record: rates that hold between rows, integrated exactly; worst 2.6e-3, by the
# row in which a rate changes.
GYROSCOPE_INTEGRAL = 5e-3
GYROSCOPE_DERIVATIVES = 1e-4
GYROSCOPE_OFFSET_SECONDS = 1e-3
GYROSCOPE_BIAS = 1e-3
GYROSCOPE_AXES = 5e-3
GYROSCOPE_SCALE = 5e-3
GYROSCOPE_FOCAL_SIGMAS = 3.0
GYROSCOPE_VELOCITIES = 0.02  # rad/s, and lengths a second: bias and noise over 15 ms
GYROSCOPE_ADJUSTED_AGAIN = 8e-7  # of poses, those of the features alone; worst 4e-7
GYROSCOPE_UP = 0.0074  # of a unit vector: how well a short flight shows the axes; worst 0.0037
GYROSCOPE_CORRECTED = 2e-3  # radians off poses of pictures alone, of a pose 0.036 off
