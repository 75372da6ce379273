"""Tolerances of the viewer."""

# relative, and scene units of a few: a float32 distance along the ray; worst 1.1e-7
PICKED_POINT = 1e-5
# degrees; bisection in double over a sum of 128 arcs' cosines, each good to 1e-8; worst 2e-6
FIELD_OF_VIEW_DEGREES = 0.01
# dB against the frames, of 65 x 49 saturated colours: chroma at half the size, or a palette of 256
# dithered; worst 33.6, 34.2 and 30.3
FILM_PSNR_DB = {".mp4": 32.0, ".webm": 32.0, ".gif": 28.0}
# of the widest spacing of photographs: how far a tour leaves the nearest one; worst 0.51
TOUR_AWAY = 1.0
# between the view and that of the nearest photograph, of a ring with one every 9 degrees; worst 3.6
TOUR_TURN_DEGREES = 7.0
MEASURED = 2e-6  # scene units of a few, float32 means turned in double; worst 6e-7
# the WebAssembly core against native code without vectors where lines are drawn: another C library
# rounds sines and cosines; images and distances of a few scene units
CORE_LINES = 1e-5
# cosine of the angle between the picture's right and up, of a path that is level: rounding of a
# polynomial of rotations in double; worst 5e-17
LEVEL_HORIZON = 1e-12
# mean levels of 255 between a picture of four flat colours and its JPEG; worst 4.1 (a strip's
# tile with chroma at half the size)
JPEG_LEVELS = 8.0
# rms levels of 255, a frame by WebGL 2 against the same one at rest: order by 16 bits of the
# distance, sums in half floats, cut at quads that take the lens as linear; worst 1.27, a panorama
# near its poles, else 0.33
MOVING_LEVELS = 2.0
# likewise where what is open takes the colour of its surroundings, roughly; worst 4.84
MOVING_SURROUNDED_LEVELS = 8.0
