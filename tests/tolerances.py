"""Every tolerance of the Python tests: value, reason, worst seen. One section a folder."""

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
