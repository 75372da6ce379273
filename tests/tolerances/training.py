"""Tolerances of what the tests train."""

PANORAMA_PSNR = 23.0  # dB, 260 steps on ten images of 160 x 80; observed 25.5
PANORAMA_SEAM_DB = 0.8  # dB that the columns at the seam may be below the others; observed -1.3
PANORAMA_SEAM_STEP = (
    1.5  # colour step across the seam over the step between its neighbours; observed 1.2
)
VIEWERS_GAIN_DB = 2.8  # of 25 steps on thin blobs; least 5.6
BLURRED_SKY = 0.06  # of colours in [0, 1]: mean over 3 x 3 pixels of clouds; worst 0.039
MOVERS_RECALL = 0.78  # share of what passes that is found, in three of nine views; observed 0.89
MOVERS_WRONG = 0.08  # of a view's pixels, the rim of what passes; worst 0.042
MOVERS_SHARE = 0.01  # of the training pixels, where movers take 0.03 of them
CUT_OUT_ALPHA = 0.02  # mean beside an object that was cut out
CUT_OUT_PSNR = 0.5  # dB, of training with emptiness below training without
