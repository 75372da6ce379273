"""Tolerances of the laboratory's tests: value, reason, worst observed."""

PROVING_DEPTH = 0.014  # relative, median; pixels of half a degree at edges; worst 0.0071
PROVING_AREA = 1e-6  # of exact poses, whose angles round to 1e-8 degrees; worst 3e-8
PROVING_SLOW_ROLLING = 0.8  # least AUC at 5 degrees of a slow rolling shutter; worst 0.92
PROVING_SAME_VIEW = 0.9  # least share of right detail of a view from the same place; worst 1.0
PROVING_SAME_LENS = 1e-6  # pixels between a lens and itself turned; worst 1e-10
PROVING_GAIN = 0.01  # stops, of a picture that is doubled; worst 0.000
NERFSTUDIO_RAYS = 1e-6  # float32 against double, its lens inverted in a few steps; worst 1.4e-7
OPEN3D_MEAN_VOXELS = 0.1  # a ball 0.069 from Open3D's mesh; a box's faces 0.047 from the truth
FOREIGN_ROUNDING = 2.0  # others cut off where we round: a step instead of half a one
FOREIGN_SPZ = {"position": 2.0**-12, "harmonics": 8.5 / 128}  # others' 12, and 5 and 4, bits
FOREIGN_SPLAT_DEGREES = 1.8  # of rotations in bytes, read as b / 127.5 - 1; worst 1.6
# Of 400 blobs with harmonics; Spark keeps these in few bits. Worst 30.0
REAL_VIEWER_DB = 29.0
REAL_VIEWER_TURNED_DB = 23.0  # turned 16.1, without harmonics 22.0
THREE_VIEWER_DB = 26.0  # three.js ends each Gaussian at two standard deviations; found 27.3
DEMO_POINT_MEDIAN = 0.016  # metres; perturbed by sigma 1 cm in each axis; worst 0.0082
DEMO_POINT_FAR = 0.08  # metres, 99 % of the points: grazing rays stretch it; worst 0.043
DEMO_POINT_COLOR_SHARE = 0.99  # of points within a pixel of their colour; worst 1
DEMO_DEPTH = 6e-4  # metres: half a stored millimetre and float32 rays; worst 5.0e-4
# grey levels of 255, median: 64-pixel images of finer textures; worst 9.7, unrelated pixels 38
DEMO_VIEW_GREY_LEVELS = 12.0
DEMO_SHARP_VIEW_GREY_LEVELS = 20.0  # the same with pixels of 5 cm; worst 15.3, unrelated ones 45
DEMO_SURFACE = 1e-5  # metres; squares of 4 m in float32, grazing rays; worst 4.3e-6
HALL_MESH = 5e-3  # metres: circles of 64 sides at a slant
