"""Rolling shutters: how long a readout takes, from the frames of a video."""

from gsut.sfm.shutter.correction import correct_readout
from gsut.sfm.shutter.readout import estimate_rates
from gsut.sfm.shutter.video import (
    VideoShutter,
    find_line_order,
    find_shutter,
    is_probably_rolling,
    list_likely_shutters,
)
