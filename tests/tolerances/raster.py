"""Tolerances of projection, raster and training."""

ORACLE_RAY = 1e-12  # gsplat inverts its lenses by Newton; its own error is 7e-14; worst 7.3e-14
ORACLE_IMAGE = 1e-9  # double against double, up to 200 terms a pixel; worst 3.7e-12
ORACLE_GRADIENT = 1e-6  # relative L2; worst 4.7e-13
# gsplat's slerp errs by about 1e-8 between the two poses (its README: 2e-8); the image and the
# gradients of exact poses differ from its own by that, times the slopes of the scene
ORACLE_SLERP = 3e-8  # worst 2.1e-8
ORACLE_SLERP_IMAGE = 2e-6  # worst 1.0e-6
ORACLE_SLERP_GRADIENT = 1e-6  # worst 3.3e-7
ORACLE_PROJECTION = 1e-9  # px, weights of -99 magnify eps of 64 px; worst 4.1e-12
PROJECTION_FLOAT_PIXELS = 1e-4  # px, float spacing at 64 px is 4e-6; worst 1.3e-5
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
# The same of covariances, relative to the trace
PROJECTION_METHODS_COVARIANCE = 1e-2
# Pixels: the same of extents
PROJECTION_METHODS_EXTENT = 1e-2
# second order: the perspective of a sphere, (scale / distance)^2 = 1e-4, and its curvature
PROJECTION_SMALL_ANGLE = 1e-3
# double against numpy, 60 terms; the inverse covariance has a condition up to 1e3; worst 1.4e-14
RENDER_DOUBLE = 1e-12
# central differences with step h = 1e-5: h^2 / 6 times third derivatives of 1e4; worst 2.1e-7
RENDER_DIFFERENCES = 1e-6
RENDER_SAME_SUMS = 1e-12  # relative; the same terms in another order, in double; worst 3.4e-14
RENDER_IDENTITY = 1e-12  # a scene turned or scaled in double: 100 eps x distance 8; worst 5.7e-14
Z_ROUNDING = 5e-7  # of depths up to 6.2, one ulp; worst 2.4e-7
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
RENDER_IMAGE_RMS = 1e-5  # worst 3.2e-7
RENDER_DEPTH = 5e-6  # relative L2: depth times alpha in float; worst 8e-7
# relative L2, the rounding of a mean (6e-8 of its distance) over scales of 1e-2 of the
# distance, in sums that cancel; worst 4.2e-5 (means)
RENDER_GRADIENT = 1e-4
RENDER_POSE_GRADIENT = 1e-4  # as above, one sum over all Gaussians; worst 6e-5
# relative; float's alpha may lie this much below the cut-off where double's lies above it
RENDER_MISS_MARGIN = 1e-4
LINES_TRAIN_RANDOM_PSNR = 15.0  # dB after 150 steps from random Gaussians; found 22.5, 30.3
# dB, of helmet_distorted_rs after 250 steps at half size, found 3.1; 11.3 after 1000 at full size
SHUTTER_LEAST_GAIN = 2.0
TRAIN_LEAST_PSNR = 25.0  # dB after 100 steps; least over all instruction sets 32.8
EWA_DISCS = 1e-6  # discs of a thousandth's thickness in place of an affine map; worst 3.2e-8
EWA_FLOAT = 2e-5  # rms would be 1e-5; the largest of all pixels; worst 5e-7
EWA_GRADIENTS = 1e-6  # relative to the largest: central differences in double; worst 2.3e-9
SURROUNDINGS_FLAT = 1e-5  # float32 rounding over the pyramid's levels; worst 2e-7
SURROUNDINGS_GRADIENT = 1e-4  # relative to the largest: float32 of a quotient; worst 2e-5
BACKGROUND_MEAN = 0.08  # four standard errors of 199 uniform numbers
PIXEL_FILTER_DB = 6.0  # gained on Gaussians below a pixel at a quarter of the size; least 11.6
PIXEL_FILTER_FLOAT = 1e-3  # float32 of logarithms, of a difference and a logit; worst 1e-4
STORED_OVERHEAD = 8e6  # bytes beside the limit: a read of 16,384 rows, rays; worst 4.2e6
INTEGRAL_TRAPEZOID = 1e-12  # what the quadrature promises; worst of 12 scenes 1.4e-14
INTEGRAL_SUM = 1e-12  # what the quadrature promises in sum; worst 6e-13
# of a mean 1e-9 before the camera: 2e-9 deviations of a density; worst 5.8e-10
INTEGRAL_INSIDE = 2e-9
# a move by 2e-9 of 0.2, times the slope of colours by place; worst 2.5e-9
INTEGRAL_CONTINUITY = 5e-9
EXTINCTION_FLIPS = 1e-3  # share of pixels on a cut-off: at most 2 of 2304; worst 0
# Share of pixels on a cut-off, or of two nearest points that are one to float: at most 2 of 1024.
RAY_ORDER_FLIPS = 2e-3  # worst 9.8e-4
# alpha of a closed form; worst 6.3e-6
PRIMITIVE_FLOAT = 1.2e-5
PRIMITIVE_DIFFERENCES = 1e-6  # as RENDER_DIFFERENCES, at a triangle's rim; worst 5.2e-7
# as RENDER_GRADIENT, nearly all of it one's that is seen edge-on: rounding over its cosine's
# square; worst 8.1e-4
PRIMITIVE_FLAT_GRADIENT = 1.6e-3
