"""Tolerances of dataset readers."""

DATA_ROUNDING = 1e-14  # one multiplication or division in double: a few eps
DATA_POSE = 1e-12  # poses of size 4 through a quaternion or an SVD in double: 100 eps; worst 2e-15
DATA_PLY_POSITION = 2e-7  # a PLY file stores float32; coordinates up to 1.5 round by 6e-8
DATA_UTM_POSITION = 2e-9  # coordinates of 5.4e6 in double have a spacing of 9.3e-10
DATA_EIGHT_BIT = 0.5  # rounding of a mean to 8 bits; worst 0.5
DATA_TEXTURE_STEP = 16  # grey levels between neighbouring pixels of the small plane; worst 13
REDUCED_DECODING_LEVELS = 12  # grey levels of a smooth JPEG against areas of the whole; worst 6
SECONDS_TO_STOP = 1.0  # processor seconds of a long call after a signal; worst 0.3
SECONDS_TO_REFUSE = 5.0  # of a file that nests or repeats without end; worst 0.9 processor seconds
