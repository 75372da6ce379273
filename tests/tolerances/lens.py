"""Tolerances of lenses, their domains and files."""

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
# Area left at 1e-9 (relative) before the edge over that at 1e-6: it vanishes linearly, and sampled
# domains end up to 1e-7 early; worst 0.084
DOMAIN_EDGE_STEP = 0.17
# As CAMERA_JACOBIAN where the second derivative jumps (quadratic splines at the knots, f-theta on
# the axis): a difference errs by about the step of 1e-5 times the jump; worst 1.5e-5
JUMPING_JACOBIAN = 3e-5
# Pixels below 1e4 against pycolmap, libmrcal, cv2.omnidir and long double; a division lens behind
# the camera, where the oracle's own formula cancels, is the worst: 9.8e-11
LENS_ORACLE_PIXELS = 2e-10
# Doubles of size 4000 through mrcal's formula in another order; worst 1.9e-12
LENS_MRCAL_PIXELS = 3.8e-12
LENS_ORACLE_RELATIVE = 1e-12  # two lenses that are one, pixels of any size; see above
PANORAMA_RAYS = 1e-15  # unit rays through a sine and a cosine: a few units in the last place
LENS_RENDER_RMS = 1e-5  # what render promises of float32
# Where a Gaussian's alpha is 1/255 to within rounding, it may be drawn by one path and not by the
# other: a step, at this many pixels of an image at most, of 1/255 times a colour up to 1.5
LENS_RENDER_STEP = 1e-4
LENS_RENDER_STEPS = 4
LENS_RENDER_CUTOFF = 6e-3
HARD_LAYERS = 1e-5  # relative: 10 000 products of float; worst 3.2e-7
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
OCAM_RAYS = 1.7e-15  # unit rays against OCamCalib's and MATLAB's formulae; worst 8.4e-16
# OCamCalib's own inverse polynomial, as published beside a calibration, against the exact inverse
OCAM_PUBLISHED_INVERSE = 0.29  # pixels; worst 0.146
# The matrix of every lens and command: 64 pixels, 60 blobs, 40 steps
EVERY_LENS_GREY_LEVELS = 0.6  # a photograph of 8 bits against the truth rendered again
EVERY_LENS_GAIN_DB = 0.94  # least observed 1.88, of equirectangular
EVERY_LENS_SAME_DB = 0.01
EVERY_LENS_COMPACT_DB = 0.33  # worst observed 0.17, of opencv5
# Turns between views after refinement against the true Gaussians over those before. Without the
# lens the worst is 0.047, of opencv12. With it five views of 64 pixels do not determine all
# lenses: most reach 0.02 to 0.2, splined_stereographic stays at 1
EVERY_LENS_REFINED = {False: 0.094, True: 1.01}
LENS_DATABASE_DIGITS = 5e-6  # relative: six digits are shipped; worst 4.4e-6
FIT_OF_OWN_RAYS = 1e-9  # px; least squares of a lens' own rays; worst 3.4e-13
FIT_BY_ANOTHER_MODEL = 0.5  # px; OPENCV8 to 100 degrees of a Kannala-Brandt lens
