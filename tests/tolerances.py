"""Every tolerance of the Python tests: value, reason, worst seen. One section a folder."""

# --- gaussians, seeding ---------------------------------------------------------------------------
HARMONICS = 1.2e-14  # scipy's own arccos and cancellation included, values up to 2.9; worst 6.0e-15
NEIGHBOR_DISTANCE = 1e-15  # the same sums and roots as scipy in double; worst 0
FLOAT32 = 1.2e-7  # one rounding to float32, 2^-23; worst 1.1e-7
ACTIVATED_FLOAT32 = 5e-7  # exp or sigmoid of a float32 parameter up to 4; worst 2.4e-7
VIEW_DISTANCE = 1e-14  # a point to world axes and back in double, coordinates below 10
VIEW_MEDIAN = 0.1  # statistical: median of 5000 distances, more than 5 standard errors

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
# --- demo_scene
DEMO_ROTATION = 1e-15  # a rotation times its transpose in double, a few eps; worst 3.4e-16
DEMO_POINT_MEDIAN = 0.016  # metres; perturbed by sigma 1 cm in each axis; worst 0.0082
DEMO_POINT_FAR = 0.08  # metres, 99 % of the points: grazing rays stretch it; worst 0.043
DEMO_POINT_COLOR_SHARE = 0.99  # of points within a pixel of their colour; worst 1
DEMO_DEPTH = 6e-4  # metres: half a stored millimetre and float32 rays; worst 5.0e-4
# grey levels of 255, median: 64-pixel images of finer textures; worst 9.7, unrelated pixels 38
DEMO_VIEW_GREY_LEVELS = 12.0
DEMO_SURFACE = 1e-5  # metres; squares of 4 m in float32, grazing rays; worst 4.3e-6
# --- cameras -------------------------------------------------------------------------------------
# Pixels against cv2 for coordinates below 1e4 px: a few units in the last place; worst 3.9e-11
CV2_PIXELS = 5e-11
# Norm of a unit ray: two units in the last place; worst 3.4e-16
UNIT_LENGTH = 4.5e-16
# ray -> pixel -> ray -> pixel: what Camera.unproject promises; worst 1.1e-11
ROUND_TRIP_PIXELS = 1e-9
# The same relative to a far pixel, or to the pixels per radian next to a pole: 16 units in the last
# place as in lens_checks.cpp; worst 6.5
ROUND_TRIP_ULPS = 16 * 2.3e-16
# Exact derivatives against central differences, relative to the Jacobian's largest entry: rounding
# of the pixels over the step; worst 1.4e-7
CAMERA_JACOBIAN = 2.8e-7
# Derivative along the ray (zero) and of scaled points, relative to the Jacobian's largest entry;
# worst 5.9e-15
JACOBIAN_ALONG_RAY = 1.2e-14
# Unit rays against the oracle, whose Newton stops at a step below 1e-6; worst 7.7e-14
ORACLE_RAYS = 1.5e-13
# Angles of folds against closed forms: the root's condition; worst 0
DOMAIN_ANGLE = 1e-12
# Domains found by sampling end 1e-9 (relative) before the fold
DOMAIN_MARGIN = 3e-9
# Area left at 1e-9 (relative) before the edge of a domain that ends at a fold, relative to the
# axis: the slope of the area there is up to 1e3; worst 1.1e-6
DOMAIN_EDGE = 2.2e-6
# Lens files: (c - 0.5) + 0.5 loses at most the last bit of a coordinate below 1e4 px
LENS_FILE_PARAMS = 2e-12
# --- bench ---------------------------------------------------------------------------------------
# The scalar float baseline against the double reference, where the rule does not jump; worst
# 3.01e-7 and, of the quaternions, 1.02e-5
SCALAR_IMAGE_RMS = 6e-7
SCALAR_GRADIENT_RELATIVE = 2e-5
BENCH_ROUNDING = 1e-12  # sums in double of numbers up to 100, in another order

# --- projection, raster, training -----------------------------------------------------------------
ORACLE_RAY = 1e-12  # gsplat inverts its lenses by Newton; its own error is 7e-14; worst 7.3e-14
ORACLE_IMAGE = 1e-9  # the issue's; double against double, up to 200 terms a pixel; worst 3.7e-12
ORACLE_GRADIENT = 1e-6  # the issue's, relative L2; worst 4.7e-13
# gsplat's slerp errs by about 1e-8 between the two poses (its README: 2e-8); the image and the
# gradients of exact poses differ from its own by that, times the slopes of the scene
ORACLE_SLERP = 3e-8  # worst 2.1e-8
ORACLE_SLERP_IMAGE = 2e-6  # worst 1.0e-6
ORACLE_SLERP_GRADIENT = 1e-6  # worst 3.3e-7
ORACLE_PROJECTION = 1e-9  # px, the issue's; weights of -99 magnify eps of 64 px; worst 4.1e-12
PROJECTION_FLOAT_PIXELS = 1e-4  # px, the issue's; float spacing at 64 px is 4e-6; worst 1.3e-5
# px, standard deviation up to which that holds; in proportion beyond; worst 0.87 of it, at a pole
PROJECTION_FLOAT_WIDTH = 24.0
# px; footprints of up to 1e6 px in steep lenses, times weights of 100, times eps; worst 3.4e-10
# px; eps times footprints of up to 1e6 px through steep lenses, weights of 100; worst 3.4e-10
PROJECTION_DOUBLE = 1e-9
# relative to the larger of the covariance and 1 px^2; a dozen float operations; worst 1.2e-5
PROJECTION_FLOAT_COVARIANCE = 2e-5
PROJECTION_FLOAT_DEPTH = 3e-7  # relative: a square root of three squares, 2-3 ulp; worst 1.6e-7
# Pixels, Gaussians of 0.02 degrees: second order of a fisheye, and float; worst 6.2e-5
PROJECTION_METHODS_CENTER = 1.2e-4
# The same of covariances, relative to the trace; simplex is the least exact
PROJECTION_METHODS_COVARIANCE = 1e-2
# Pixels: boxes of outlines may be narrower than their ellipse by the second order
PROJECTION_METHODS_BOX = 1e-2
# second order: the perspective of a sphere, (scale / distance)^2 = 1e-4, and its curvature
PROJECTION_SMALL_ANGLE = 1e-3
# double against numpy, 60 terms; the inverse covariance has a condition up to 1e3; worst 1.4e-14
RENDER_DOUBLE = 1e-12
# central differences with step h = 1e-5: h^2 / 6 times third derivatives of 1e4; worst 2.1e-7
RENDER_DIFFERENCES = 1e-6
RENDER_SAME_SUMS = 1e-12  # relative; the same terms in another order, in double; worst 3.4e-14
RENDER_IDENTITY = 1e-12  # a scene turned or scaled in double: 100 eps x distance 8; worst 5.7e-14
RENDER_FLOAT_ROUNDING = 3e-7  # alpha and colour in [0, 1], 2-3 ulp of float; worst 1.4e-7
RENDER_CLOSED_FORM = 1e-6  # one Gaussian on one ray in float: a dozen roundings of 6e-8
# A discontinuity explains a difference: alpha or response this close to its cut-off (float errs by
# 1e-6); keys this close, relative (16 ulp); transmittance this close to the stop, relative (float
# products of up to 150 factors); a nearest point this close to the camera, over the distance.
RENDER_CUT_MARGIN = 1e-5
RENDER_KEY_MARGIN = 1e-6
RENDER_STOP_MARGIN = 1e-4
RENDER_ORIGIN_MARGIN = 1e-5
RENDER_FLIP = 1e-4  # a difference beyond it must have such a reason
RENDER_FLIPS_A_PIXEL = 1e-4  # of all pixels of the hundred scenes; worst 1.6e-5
RENDER_IMAGE_RMS = 1e-5  # the issue's; worst 3.2e-7
RENDER_DEPTH = 5e-6  # relative L2: depth times alpha in float; worst 8e-7
# relative L2, the issue's; the rounding of a mean (6e-8 of its distance) over scales of 1e-2 of the
# distance, in sums that cancel; worst 4.2e-5 (means)
RENDER_GRADIENT = 1e-4
RENDER_POSE_GRADIENT = 1e-4  # as above, one sum over all Gaussians; worst 6e-5
# relative; float's alpha may lie this much below the cut-off where double's lies above it
RENDER_MISS_MARGIN = 1e-4
LINES_IMAGE_RMS = 1e-5  # the issue's; worst 1.1e-7
LINES_GRADIENT = 1e-4  # relative L2, the issue's; worst 1.2e-5, of the poses 2.7e-5
LINES_TRAIN_RANDOM_PSNR = 15.0  # dB after 150 steps from random Gaussians; found 22.5, 30.3
# dB, of helmet_distorted_rs after 250 steps at half size, found 3.1; 11.3 after 1000 at full size
SHUTTER_LEAST_GAIN = 2.0
# Share of the motion within a frame by which start and end poses from neighbours' velocities miss.
# Central differences of a made sway, see the test; found 0.1415.
READOUT_POSE_SHARE = 0.28
# Standard errors of a million samples by which a quadrature may differ, of 160 comparisons; the
# worst of as many normal numbers is 2.5 to 4.
MONTE_CARLO_WORST_SCORE = 4.5
TRAIN_LEAST_PSNR = 25.0  # dB after 100 steps; least over all instruction sets 32.8

# --- hard cases -----------------------------------------------------------------------------------
HARD_IMAGE = 1e-4  # RENDER_FLIP: what differs by more has a reason and is left out; worst 9.9e-5
HARD_ALPHA = 1e-5  # one Gaussian, also around the camera, with or without a jump; worst 1.9e-6
HARD_DEPTH = 5e-6  # relative L2; worst 1e-6
# relative L2 of each array; needles and near Gaussians: 6e-8 of the distance over the scale, in
# sums that cancel; worst 6.9e-4
HARD_GRADIENT = 1e-3
# A gradient below this share of the scene's largest is compared with that share: of a round
# Gaussian, that to the quaternion is 0 but for rounding (4e-7 of the largest).
HARD_ZERO_GRADIENT = 1e-2
HARD_ROLLING_ALPHA = 3.4e-6  # of images that a rolling shutter sees, but for jumps; worst 1.7e-6
HARD_JUMPS_AN_IMAGE = 5  # pixels exactly on a discontinuity
HARD_NEEDLE = 1e-4  # alpha of needles up to 300 : 1, but for flips; worst 8.2e-5
HARD_NEEDLE_GRADIENT = 1e-3  # worst 4.8e-4
HARD_WALL = 4e-6  # a wall of any width against its closed form; worst 1.8e-6
# alpha errs by at most this times eps x distance / smallest scale: three roundings of half an ulp
# of the mean's place, times 0.61 (the steepest slope of exp(-D^2 / 2)), times opacity 0.9 = 0.4
HARD_RESPONSE_ULPS = 0.5
# --- lenses ---------------------------------------------------------------------------------------
# Area left at 1e-9 (relative) before the edge over that at 1e-6: it vanishes linearly, and sampled
# domains end up to 1e-7 early; worst 0.084
DOMAIN_EDGE_STEP = 0.17
# As CAMERA_JACOBIAN where the second derivative jumps (quadratic splines at the knots, f-theta on
# the axis): a difference errs by about the step of 1e-5 times the jump; worst 1.5e-5
JUMPING_JACOBIAN = 3e-5
# Pixels below 1e4 against pycolmap, libmrcal, cv2.omnidir and long double; a division lens behind
# the camera, where the oracle's own formula cancels, is the worst: 9.8e-11
LENS_ORACLE_PIXELS = 2e-10
LENS_ORACLE_RELATIVE = 1e-12  # two lenses that are one, pixels of any size; see above
PANORAMA_RAYS = 1e-15  # unit rays through a sine and a cosine: a few units in the last place
LENS_RENDER_RMS = 1e-5  # what render promises of float32
# Where a Gaussian's alpha is 1/255 to within rounding, it may be drawn by one path and not by the
# other: a step, at this many pixels of an image at most, of 1/255 times a colour up to 1.5
LENS_RENDER_STEP = 1e-4
LENS_RENDER_STEPS = 4
LENS_RENDER_CUTOFF = 6e-3
LENS_GRADIENT_RELATIVE = 1e-4
HARD_RESPONSE_FLOOR = 4e-6  # alpha of a round Gaussian; worst 3.4e-6
HARD_LAYERS = 1e-5  # relative: 10 000 products of float; worst 3.2e-7
HARD_LAYERS_IMAGE = 1e-5  # 700 layers, then the stop; worst 5e-7
HARD_PROJECTION_PIXELS = 2e-4  # px at 640 px (float spacing 6e-5); worst 9.3e-5
HARD_DETERMINANT = 1e-4  # of a covariance over the product of its variances; rounding of 1e-6
# All twenty on small scenes (tests/hard/test_hard_matrix.py): float by every instruction set and
# double, largest difference of an image and relative L2 of the gradients; at most twice the worst
HARD_CASES = {
    1: (7.4e-6, 3.2e-5),  # weights of -99 and -1e6 bound the tiles; worst 3.9e-6, 1.7e-5
    2: (8.1e-7, 4.5e-6),  # sigma points without a pixel; worst 4.3e-7, 2.4e-6
    3: (1.5e-7, 1.8e-6),  # the camera inside; worst 8.0e-8, 9.6e-7
    4: (1.9e-7, 1.4e-4),  # mirrored hits; worst 1.0e-7, 7.8e-5
    5: (4.1e-6, 1.5e-5),  # 270 and 350 degrees; worst 2.2e-6, 8.1e-6
    6: (4.5e-6, 8.9e-6),  # folds; worst 2.4e-6, 4.7e-6
    7: (2.2e-6, 1.3e-5),  # a pole; worst 1.2e-6, 7.3e-6
    8: (3.9e-6, 1.1e-5),  # pixels without a ray; worst 2.1e-6, 6.1e-6
    9: (5.1e-7, 1.7e-4),  # on the axis, ahead and behind; worst 2.7e-7, 9.4e-5
    # Needles: their place is known to eps x distance, over their thickness; worst 1.0e-5, 7.1e-5
    10: (1.9e-5, 1.3e-4),
    # 1e6 : 1, sheets of 3e-7 of the distance, quaternions of any norm; worst 5.3e-7, 5.6e-5
    11: (1e-6, 1e-4),
    12: (8.9e-5, 6.4e-4),  # below the rounding of pixels: as 10; worst 4.7e-5, 3.4e-4
    13: (1.6e-5, 2.2e-4),  # below a pixel, with and without the filter; worst 8.5e-6, 1.2e-4
    14: (1e-4, 2.2e-4),  # opaque layers, opacity 0 and 1; RENDER_FLIP; worst 9.4e-5, 1.2e-4
    15: (1.8e-6, 7.7e-5),  # hostile bounds; worst 9.5e-7, 4.1e-5
    16: (7.6e-7, 1.5e-5),  # equal depths; worst 4.0e-7, 8.2e-6
    17: (1.4e-6, 7.2e-6),  # a rolling shutter that turns fast; worst 7.6e-7, 3.8e-6
    18: (2.2e-6, 5.7e-6),  # 1e6 from the origin, scenes of 1e-3 and 1e4; worst 1.2e-6, 3.0e-6
    19: (9.5e-7, 5.8e-6),  # seams and poles; worst 5.0e-7, 3.1e-6
    20: (6.6e-7, 6.2e-5),  # images of 1 x 1 to 17 x 15, of none and of one; worst 3.5e-7, 3.3e-5
}

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
CALIB_WARP_METRES = 2.3e-5  # of 20 boards with 0.05 px of noise; worst observed 1.16e-5
CALIB_BENT_DEGREES = 0.029  # of its rays to 60 degrees; worst observed 0.0146, taken for flat 0.22
CALIB_SIGMA_RATIO = (0.5, 2.0)  # mrcal's uncertainty over ours; other unknowns, other priors
# RMS (2-D, px) of the real left fisheye, as found before gsut with each solver; found 0.1773,
# 0.1685, 0.1496
CALIB_REAL_RIG_DEGREES = 0.1  # issue 5; worst observed 0.053
CALIB_REAL_RIG_METRES = 0.0005  # issue 5; worst observed 0.23 mm
CALIB_REAL_FISHEYE_PX = 0.180
CALIB_REAL_OPENCV8_PX = 0.172
CALIB_REAL_SPLINED_PX = 0.152
CALIB_DRAWN_LENS_PX = 0.6  # focal lengths and centre from ten drawn boards; worst 0.31
CALIB_WIDE_PX = 0.25  # focal lengths and centre from 24 boards with 0.05 px of noise; found 0.11
# A sector of a splined lens ends at the nearest of its sides: up to 2 % before the control points,
# or where this much of the area on the axis is left before a fold
SPLINE_SECTOR = 0.98
SPLINE_EDGE = 0.1
# Fitting a lens by one that holds it: pixels, where Levenberg-Marquardt stops; worst 1e-9
CONVERT_EXACT = 1e-6
# Pixels, TUM-VI's fisheye up to 0.9 rad by models that cannot hold it: 1.9 times what each leaves
CONVERT_TARGETS = {
    "cahvore": 0.00011,
    "cahvor": 1.1,
    "division": 0.48,
    "equirectangular": 1.8e02,
    "fov": 0.035,
    "ftheta": 0.0011,
    "latlon": 31,
    "lonlat": 30,
    "mei": 0.00044,
    "opencv14": 4.5e-06,
    "opencv12": 4.5e-06,
    "orthographic": 15,
    "pinhole": 39,
    "splined_stereographic": 0.00023,
    "stereographic": 7.5,
    "thin_prism_fisheye": CONVERT_EXACT,
    "unified": 0.075,
}
CONVERT_SPLINE = 6e-3  # pixels, a fisheye of 200 degrees on 16 control points; worst 2.8e-3
CONVERT_PUPIL = 1e-3  # pixels, a lens whose pupil moves, at two distances
# --- rigs in gsut poses: two cameras 0.3 apart, 10 moments of a walk 2 wide, points 3 to 7 away ---
RIG_EXACT = 8e-14  # units and degrees, exact tracks, no scale taken out, 3 seeds; worst 3.8e-14
RIG_UNITS = 0.007  # centres, 0.2 px of noise, the first pose laid on truth, 3 seeds; worst 0.0035
RIG_DEGREES = 0.1  # the same; worst 0.050, of an image with six points and its mate
RIG_FEW_UNITS = 0.011  # a moment of ten points in each camera, 3 seeds; worst 0.0053
RIG_FEW_DEGREES = 0.1  # the same; worst 0.048
RIG_HELD = 5.2e-15  # poses of a moment's cameras to each other; worst 2.6e-15
RIG_DEMO_SCALE_PERCENT = 0.09  # six moments of the demo's rig at 200 x 200; worst 0.045
RIG_DEMO_METRES = 0.0056  # centres there, no scale taken out; worst 0.0028
RIG_SCALE_SIGMA = (
    2.0  # errors of the scale over their standard error, rms of 12 runs, either way; found 1.33
)
RIG_SIZE = 8.9e-16  # of a refined rig, relative; worst 4.5e-16
RIG_REFINED_DEGREES = 0.021  # left of 0.5, 3 seeds; worst 0.0107
RIG_REFINED_SHARE = 0.0035  # of the baseline, left of 0.01, 3 seeds; worst 0.0017
# --- structure from motion -----------------------------------------------------------------------
# Degrees, of 8 images of 500 points with 0.2 px of noise at 300 px a radian; worst 0.016
SFM_SYNTHETIC_DEGREES = 0.02
SFM_SYNTHETIC_ATE_PERCENT = 0.011  # of the path, the same scene; worst 0.0057
SFM_FOCAL = 1.3e-4  # relative, of a lens found from 8 to 10 images, 0.1 px of noise; worst 6.8e-5
SFM_AS_FISHEYE_PX = 0.013  # two models of one lens without a tangential part; worst 6.9e-3
SFM_EXACT = 1e-14  # pose of exact points: some units in the last place; worst 3.3e-16
# Median, 12 images of sponza_fisheye, whose short path fixes the similarity badly; worst 0.089
SFM_SPONZA_DEGREES = 0.1
SFM_SPONZA_ATE_PERCENT = 0.04  # of their extent; worst 0.021
# A rolling walk of 10 images of 500 points, 0.1 px of noise, 3 seeds; worst 0.060 degrees, 0.0062 %
SFM_ROLLING_DEGREES = 0.12
SFM_ROLLING_ATE_PERCENT = 0.012
SFM_READOUT_TIME = 0.0015  # of the time between frames; worst 7.6e-4
SFM_HELMET_DEGREES = 3.0  # turn in a readout, 14 views of helmet_distorted_rs; worst 1.64
SFM_COVARIANCE = 3.8  # mean normalised square of pose errors over 6, either way; worst 1.9
SIFT_BLOB_PIXELS = 0.06  # SIFT's place of a Gaussian blob; worst 0.031
# Two runs on the same images: threads add in another order, and a step of the solver more or less
# may follow from that; worst 4.4e-14
SFM_REPEAT_DEGREES = 1e-6
# A lens refined from 8 images of 700 points with 0.2 px of noise: its errors in its own standard
# deviations (8 parameters, normal: beyond 4 once in 2000 draws)
REFINED_LENS_SIGMAS = 4.0
# Root mean square of such errors over 16 draws; statistical: k1 to k4 hang together, so that about
# 60 of the 128 are independent; found 1.11
REFINED_SIGMA_RATIO = (0.75, 1.3)
# Of the noise: the median residual of a fit by Cauchy's loss is too small; found 8 to 13 % low
REFINED_NOISE_RELATIVE = 0.16

# --- compaction -----------------------------------------------------------------------------------
# relative L2 of blend weights and their sum: float sums over some thousand pixels; worst 1.3e-7
COMPACT_WEIGHTS = 2.6e-7
COMPACT_SUMS = 1e-7  # relative: sums of some thousand floats in other orders; worst 1.8e-8
COMPACT_SCORE = 1e-6  # relative: one formula in two orders of rounding
# Relative: double along rays that are stored as floats; worst 2.9e-9 and 1e-10
COMPACT_HITS = 6e-9
COMPACT_WINNER_POINT = 5e-7  # world units of about 1: a point in float; worst 2.7e-7
COMPACT_WINNER = 1e-12  # two weights as equal as double can tell; worst 0
# Relative: as above, squared derivatives; worst 4.0e-8
COMPACT_FISHER = 8e-8
COMPACT_LOG_DET = 1e-6  # of a determinant of 6 x 6 numbers as good as that; worst 4.8e-7
# Relative: central differences without the cut-off at 1/255, which is worth 1e-3; worst 3.8e-4
COMPACT_FISHER_DIFFERENCES = 7.6e-4
# Image rms after merging pairs of equal Gaussians back; some merge with neighbours; worst 0.016
COMPACT_DUPLICATES = 0.032
COMPACT_INVARIANCE_DB = 1e-3  # what is promised; worst 8e-6
COMPACT_BYTES = 210  # peak, of each Gaussian with the arrays given (56); worst 105
COMPACT_SECONDS = 12.0  # processor seconds of 100 000: a million in 60 s on two cores; found 3.2
# --- low-pass filter
LOW_PASS_DOUBLE = 7e-15  # exponentials and logarithms in double, tens of eps; worst 3.5e-15
LOW_PASS_GRADIENT = 1e-5  # central differences of step 1e-6 in double, as bounds of the others
LOW_PASS_FLOAT = 1.2e-7  # L2, parameters rounded to float32: 1 ulp; worst 2.7e-8
LOW_PASS_RADIUS = 4e-5  # differences over 0.002 px against derivatives; worst 2.1e-5
LOW_PASS_GAIN_DB = 3.0  # dB at 1/16 of the size; observed 5.4
# --- panoramas that train
PANORAMA_PSNR = 23.0  # dB, 260 steps on ten images of 160 x 80; observed 24.2
PANORAMA_SEAM_DB = 0.8  # dB that the columns at the seam may be below the others; observed 0.4
PANORAMA_SEAM_STEP = (
    1.5  # colour step across the seam over the step between its neighbours; observed 1.2
)

# --- gradients to lenses, refinement --------------------------------------------------------------
LENS_OF_IMAGE_GRADIENT = 6e-6  # central differences of step 1e-5 in double; worst 3.1e-6
LENS_OF_IMAGE_FLOAT = 1.4e-5  # relative L2; worst 7.0e-6
RAYS_FLOAT = 1e-5  # the same, of every pixel's ray; worst 5e-6
LENS_IDENTITY = 1e-9  # sums in double in another order
ORACLE_LENS_GRADIENT = 3e-10  # gsplat's Newton stops at 1e-6; worst 1.5e-10
# --- poses from colours
REFINE_POSE_GRADIENT = 3e-5  # relative L2: float32 kernels, sums that cancel; worst 1.1e-5
REFINE_RAY_GRADIENT = 3e-5  # the same, pixel by pixel; see above
REFINE_LENS_GRADIENT = 3e-5  # the same, by the lens; see above
REFINED_DEGREES = 2e-5  # float32 renders of 96 x 80 pixels; worst 6.6e-6
REFINED_UNITS = 2e-7  # the same, scene of 6 units; worst 7.2e-8
REFINED_CHI_SQUARE = 2.4  # of 20 scores of 6 degrees of freedom: 3 standard errors; found 1.7
MEAN_MOTION_DEGREES = 1e-2  # exact to first order: motions of 0.3 degrees, products of 0.003
MEAN_MOTION_UNITS = 1e-2  # the same; motions of 0.04 units, centres some units from the origin
REFINED_JOINT_DEGREES = 6e-4  # five images with their lens, 96 x 80 pixels; worst 3.2e-4
REFINED_JOINT_UNITS = 2.8e-5  # the same; worst 1.4e-5
REFINED_JOINT_FOCAL = 1.8e-5  # the same, relative; worst 9.2e-6
# Of the disturbance that is left after 240 steps of 64 pixels; chaotic, worst of four instruction
# sets: rotation 0.35, centres 0.22.
REFINED_TRAINING_SHARE = 0.7
# Of 2 degrees and 8 cm that tracks of 12 photographs of 160 pixels leave; 0.11 and 0.15.
TRACKS_DEGREES_SHARE = 0.21
TRACKS_CENTERS_SHARE = 0.3
REFINED_KEPT_SHARE = 0.2  # of the errors that unchecked colours add to true poses; worst 0.0
REFINED_TRAINING_FOCAL = 2e-2  # of 3 %, the same; 1.3e-3 to 1.4e-2
REFINED_DRIFT = (
    0.03  # what the start's own 0.05 units over 0.5 leave of 12 views: 0.03; worst 0.016
)
MATCHED_DEGREES = 5e-4  # a rendered photograph of 160 x 160 pixels in 8 bits; worst 2.1e-4
MATCHED_UNITS = 2e-5  # the same; worst 7.9e-6
LOCALIZED_UNITS = 5e-3  # of a photograph of 48 x 48 pixels in 8 bits, 4 units away
LOCALIZED_SHRUNK_UNITS = 0.02  # pixels that are means over areas against rays at their middles

# --- calibration weights, lenses from data sets
UNCERTAINTY_STORED_PX = (
    2e-6  # maps are written with 6 decimals, interpolation is linear; worst 1e-6
)
