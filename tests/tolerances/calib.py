"""Tolerances of lenses from boards and from datasets."""

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
    "opencv4": 1.1,
    "opencv14": 4.5e-06,
    "opencv12": 4.5e-06,
    "orthographic": 15,
    "pinhole": 39,
    "splined_stereographic": 0.00023,
    "stereographic": 7.5,
    "thin_prism_fisheye": CONVERT_EXACT,
    "unified": 0.075,
}
CONVERT_OTHERS = 0.5  # models that are not listed, of any kind that can hold a fisheye
CONVERT_SPLINE = 6e-3  # pixels, a fisheye of 200 degrees on 16 control points; worst 2.8e-3
CONVERT_PUPIL = 1e-3  # pixels, a lens whose pupil moves, at two distances
